# SPDX-License-Identifier: Apache-2.0
"""A bird of a free flight: it steps by its own timer, with the latest received values.

This module uses no ROS and no clock of its own: the caller passes the time. Once the flight has
begun, no bird waits for another one. A bird publishes its state at the beginning of each step. It
computes the step with the latest received state of each neighbour, extrapolated by the link model.
So the flight depends on the arrival times of messages: it cannot be repeated or rewound.
"""

from __future__ import annotations

import math
from collections import Counter

import numpy as np

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.configuration.perturbation import Perturbation
from flock_sim.messages.epochs import NEVER, ahead
from flock_sim.messages.rejection import (
    AGAIN,
    FOREIGN,
    IMPOSSIBLE,
    MALFORMED,
    MISSHAPEN,
    REPEATED,
    STALE,
    STRANGE,
)
from flock_sim.messages.topics import bird_name
from flock_sim.messages.types import Ages, Checkpoint, Grant, Stage, Wing
from flock_sim.physics.arrays import FloatArray
from flock_sim.physics.runge_kutta import STAGES
from flock_sim.protocol.latest_values import LatestValues
from flock_sim.protocol.motion import Motion
from flock_sim.protocol.neighbours import Listener, Neighbourhood
from flock_sim.protocol.session import Channel, Outgoing, Session

REPORT_EVERY = 0.25
"""Time between two reports to the clock, in s."""


class FreeBird(Listener):
    """One bird of a free flight. Pass it messages and the time; send the messages it returns.

    >>> from flock_sim.messages.handshake import handshake
    >>> flock = FlockConfiguration(birds=1, t_max=2.0, record_every=1)
    >>> bird = FreeBird(1, flock, factor=1.0)
    >>> out = bird.receive_grant(Grant(7, 0, 2, 1.0, 1, handshake(flock, 1.0)))
    >>> out += bird.receive_grant(Grant(7, 2, 2, 1.0, 1, handshake(flock, 1.0)))
    >>> for now in (100.0, 100.02, 100.05, 100.1):  # a step takes 0.0417 s
    ...     out += bird.tick(now)
    >>> [channel.value for channel, _ in out if channel is not Channel.PROGRESS]
    ['wing', 'stage', 'ages', 'state', 'stage', 'ages', 'state', 'stage', 'ages', 'state']
    """

    def __init__(
        self,
        bird: int,
        configuration: FlockConfiguration,
        factor: float,
        run_id: int = 0,
        incarnation: int = 0,
    ) -> None:
        """Place bird 1..N at its start. `factor` is the real-time factor.

        `run_id` and `incarnation` are as in `BirdProtocol`.
        """
        self.bird = bird
        self.ignored_for = Counter()
        self.ignored = 0
        self._step = 0
        self.late = 0
        """Number of steps that were taken when the next one was already due."""
        self.lateness = 0.0
        """Largest delay of a step after it was due, in s."""
        self._configuration = configuration
        self._factor = factor
        self._period = configuration.dt * configuration.second / factor
        self._session = Session(bird_name(bird), configuration, run_id, incarnation, factor)
        self._granted = -1
        self._reached = -1
        self._begun: float | None = None  # when step 0 was taken
        self._reported = -math.inf
        self._said: Outgoing | None = None  # the last state sent
        self._around = Neighbourhood(bird, configuration)
        self._latest = LatestValues(bird, self._around.birds, configuration)
        self._age_max = np.zeros(len(self._around.birds))
        self._pushes: dict[int, list[Perturbation]] = {}
        for push in configuration.pushes:
            if push.bird == bird:
                self._pushes.setdefault(push.step, []).append(push)
        self._motion = Motion(bird, configuration, self._around)
        self._motion.start()
        self._push()

    @property
    def step(self) -> int:
        """The next step to take; last step + 1 at the end."""
        return self._step

    @property
    def joined(self) -> bool:
        """Whether the run and the epoch are known."""
        return self._session.epoch != NEVER

    @property
    def in_flight(self) -> bool:
        """Whether the flight has begun for this bird."""
        return self._reached >= 0 and self._granted > 0

    @property
    def finished(self) -> bool:
        """Whether the last step is reached and its state is sent, or the run has ended."""
        return self.released or self.step > self._session.end

    @property
    def missing(self) -> list[int]:
        """The neighbours that this bird waits for: none, in a free flight."""
        return []

    @property
    def due(self) -> float:
        """Time at which the next step is due, in s; inf if the bird must wait for another node."""
        last = self.step == self._session.end
        if not self.in_flight or self.finished or self.step >= self._granted + last:
            return math.inf
        return -math.inf if self._begun is None else self._begun + self.step * self._period

    @property
    def waiting_for(self) -> str:
        """What the bird needs to continue, as text."""
        if self._session.epoch == NEVER:
            return "the clock's first grant"
        if unknown := self._around.unknown:
            return f"the wing of {', '.join(map(bird_name, unknown))}"
        if self._reached < 0:
            unheard = np.flatnonzero(self._latest.steps < 0).tolist()
            names = [bird_name(self.neighbours[k]) for k in unheard]
            return f"the first state of {', '.join(names)}"
        if self.finished:
            return "the clock's message that the run is over"
        if math.isinf(self.due):
            return f"the clock's grant beyond step {self.step}"
        return f"the time of step {self.step}"

    def receive_checkpoint(self, checkpoint: Checkpoint) -> list[Outgoing]:
        """Do nothing: a free flight uses no checkpoints."""
        return []

    def receive_wing(self, wing: Wing) -> list[Outgoing]:
        """Store the wing of a neighbour, and get ready if possible."""
        if reason := self._around.hear(wing, self.run_id):
            return self.ignore(reason)
        return self._get_ready()

    def receive_stage(self, data: bytes, sent: float = -math.inf) -> list[Outgoing]:
        """Take the state of a neighbour at the beginning of a step, sent at time `sent`, in s."""
        try:
            message = Stage.decode(data)
        except ValueError:
            return self.ignore(MALFORMED)
        if reason := self._refused(message):
            return self.ignore(reason)
        if not self._latest.take(message, sent):
            return self.ignore(AGAIN)
        return self._get_ready()

    def tick(self, now: float) -> list[Outgoing]:
        """Take the step that is due at time `now`, in s, if one is; return the messages to send.

        A late bird takes one step per call.
        """
        if now < self.due:
            return []
        if self._begun is None:
            self._begun = now
        lateness = now - (self._begun + self.step * self._period)
        self.late += lateness >= self._period
        self.lateness = max(self.lateness, lateness)
        out = [self._say()] if self.step else []  # the first was sent before the flight began
        age = now - np.maximum(self._latest.sent, self._begun)
        self._age_max = np.maximum(self._age_max, age)
        self._feel(0)
        if self.step % self._configuration.record_every == 0:
            out += self._record(age)
        last = self.step == self._session.end
        self._reached = self.step
        if last or self.step + 1 >= self._granted or now >= self._reported + REPORT_EVERY:
            self._reported = now
            out.append(self._progress(self._reached))
        if not last:
            for stage in range(1, STAGES):
                self._feel(stage)
        self._step += 1
        if not last:
            self._push()
        return out

    def report(self) -> list[Outgoing]:
        """Return the messages of a waiting bird: its progress and its last state.

        The state is repeated since a neighbour may not have known the run when it first arrived.
        """
        if self._session.epoch == NEVER:
            return []
        self._session.hear_nothing()
        return [self._progress(self._reached), *([self._said] if self._said else [])]

    def _join(self, grant: Grant, first: bool) -> list[Outgoing]:
        """Join the grant's epoch: return a progress report and the state."""
        self._reached = -1
        self._extend(grant)
        out = [self._progress(self._reached)]
        if first:
            ratio = self._configuration.span_ratio[self.bird - 1]
            out.insert(0, (Channel.WING, Wing(self.run_id, self.bird, ratio).encode()))
            self._around.recall(self.run_id)
        return [*out, self._say(), *self._get_ready()]

    def _extend(self, grant: Grant) -> list[Outgoing]:
        """Continue as far as the grant allows."""
        self._granted = max(self._granted, min(grant.step, grant.end))
        self._session.flying = self.in_flight
        return []

    def _get_ready(self) -> list[Outgoing]:
        """Report, once all neighbours are known, that the flight can begin for this bird.

        A bird that has a grant before that has joined a flight that began without it: no report.
        """
        ready = self._around.known and self._latest.complete
        if self._reached >= 0 or self._session.epoch == NEVER or self._granted > 0 or not ready:
            return []
        self._motion.learn_geometry()
        self._feel(0)  # the first call loads the compiled kernel; `tick` repeats it
        self._reached = 0
        return [self._progress(self._reached)]

    def _refused(self, message: Stage) -> str:
        """Return why a message of a neighbour is ignored, or ""."""
        members = self._configuration.members
        values = message.position, message.speed, message.circulation
        if message.run_id != self.run_id or self._session.epoch == NEVER:
            return FOREIGN
        if message.epoch != self._session.epoch:
            return STALE if ahead(message.epoch, self._session.epoch) < 0 else REPEATED
        if message.bird not in self.neighbours:
            return STRANGE
        if any(len(numbers) != members for numbers in values):
            return MISSHAPEN
        if message.stage or message.step > self._configuration.steps:
            return REPEATED
        if message.step == 0 and not all(np.all(np.isfinite(numbers)) for numbers in values):
            return IMPOSSIBLE
        return ""

    def _feel(self, stage: int) -> None:
        """Compute the drag at a stage of this step, and the values at the next stage."""
        heard = self._latest.known(self.step, stage)
        self._motion.compute(STAGES * self.step + stage, heard)

    def _push(self) -> None:
        """Apply the perturbations at the beginning of this step."""
        if pushes := self._pushes.get(self.step):
            self._motion.push(pushes)

    def _say(self) -> Outgoing:
        """Return the message with the state at the beginning of this step."""
        numbers = self._motion.numbers(STAGES * self.step)
        message = Stage(self.run_id, self.step, self._session.epoch, self.bird, 0, *numbers)
        self._said = Channel.STAGE, message.encode()
        return self._said

    def _record(self, age: FloatArray) -> list[Outgoing]:
        """Return the messages to the recorder for this step."""
        state = self._motion.state(self.step, self.run_id, self._session.epoch)
        ages = Ages(
            self.run_id,
            self.step,
            self._session.epoch,
            self.bird,
            age,
            self._age_max,
            (self.step - self._latest.steps).astype(np.float64),
            self.late,
            self.lateness,
        )
        self._age_max = np.zeros_like(age)
        return [(Channel.AGES, ages.encode()), (Channel.STATE, state.encode())]
