# SPDX-License-Identifier: Apache-2.0
"""A bird that flies freely: it steps by its own timer, on whatever it has last heard.

No ROS and no clock of its own: the time is handed in. Nobody waits for anybody once the flight has
begun. A bird says its state at the beginning of each step, and takes the step with the latest state
that it has of each neighbour, moved on as the model of the link does. So what is flown depends on
when messages arrive: it is the real thing, it cannot be repeated, and it cannot go back.
"""

from __future__ import annotations

import math
from collections import Counter

import numpy as np

from flock_sim.core import formation
from flock_sim.core.bird_step import (
    DRAG,
    POSITION,
    SPEED,
    WORK_ROWS,
    begin,
    constants,
    feel_and_move,
)
from flock_sim.core.configuration import FlockConfiguration
from flock_sim.core.free_flight import NO_WAY_BACK
from flock_sim.core.kernel import FloatArray
from flock_sim.core.links.latest import Latest
from flock_sim.core.listener import Listener
from flock_sim.core.messages import Ages, Checkpoint, Grant, Progress, Stage, State, Wing
from flock_sim.core.neighbourhood import Neighbourhood
from flock_sim.core.perturbation import Perturbation
from flock_sim.core.protocol import Channel, Outgoing
from flock_sim.core.runge_kutta import STAGES
from flock_sim.core.scaling import Scales
from flock_sim.core.stage_inbox import (
    AGAIN,
    FOREIGN,
    IMPOSSIBLE,
    MALFORMED,
    MISSHAPEN,
    NEVER,
    REACH,
    REPEATED,
    STALE,
    STRANGE,
)
from flock_sim.core.stage_message import stage_numbers, stage_words
from flock_sim.core.terms import agree
from flock_sim.core.topics import bird_name
from flock_sim.errors import RunFailed

REPORT_EVERY = 0.25
"""Time between two reports to the clock, in s."""


class FreeBird(Listener):
    """One bird of a free flight. Feed it what arrives, and the time; send what it returns.

    >>> from flock_sim.core.terms import terms
    >>> flock = FlockConfiguration(birds=1, t_max=2.0, record_every=1)
    >>> bird = FreeBird(1, flock, factor=1.0)
    >>> out = bird.receive_grant(Grant(7, 0, 2, 1.0, 1, terms(flock, 1.0)))
    >>> out += bird.receive_grant(Grant(7, 2, 2, 1.0, 1, terms(flock, 1.0)))
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
        life: int = 0,
    ) -> None:
        """Place bird 1..N at its start. `factor`: how much faster than real time it flies.

        `run_id` and `life` are as those of a `BirdProtocol`.
        """
        self.bird = bird
        self.run_id = run_id
        self.life = life
        self.released = False
        """Whether the clock has said that the run is over, and nobody needs this bird any more."""
        self.ignored_for = Counter()
        self.ignored = 0
        self.step = 0
        """The step that is taken next; one beyond the last at the end."""
        self.late = 0
        """How many steps were taken only when the next one was due as well."""
        self.lateness = 0.0
        """The most that a step was taken after it was due, in s."""
        self._configuration = configuration
        self._factor = factor
        self._period = configuration.dt * configuration.second / factor
        self._epoch = NEVER
        self._end = configuration.steps
        self._granted = -1
        self._reached = -1
        self._begun: float | None = None  # when step 0 was taken
        self._reported = -math.inf
        self._said: Outgoing | None = None  # the last state sent
        self._own = constants(bird, configuration)
        self._around = Neighbourhood(bird, configuration)
        self._latest = Latest(bird, self._around.birds, configuration)
        self._age_max = np.zeros(len(self._around.birds))
        self._pushes: dict[int, list[Perturbation]] = {}
        for push in configuration.pushes:
            if push.bird == bird:
                self._pushes.setdefault(push.step, []).append(push)
        members = configuration.members
        self._mine = np.zeros((2, stage_words(members)))
        self._work = np.zeros((WORK_ROWS, members))
        self._work[POSITION] = formation.start_position(bird, configuration.birds)
        self._work[SPEED] = Scales.of(configuration).cruise_speed
        self._push()
        begin(self._own, self._mine, self._work)

    @property
    def joined(self) -> bool:
        """Whether it is known which messages are of its run and epoch."""
        return self._epoch != NEVER

    @property
    def in_flight(self) -> bool:
        """Whether the flight has begun for it."""
        return self._reached >= 0 and self._granted > 0

    @property
    def finished(self) -> bool:
        """Whether the last step is reached and its state is out, or the run is over anyhow."""
        return self.released or self.step > self._end

    @property
    def missing(self) -> list[int]:
        """The neighbours that are waited for: none, in a free flight."""
        return []

    @property
    def due(self) -> float:
        """When the next step is to be taken, in s; inf where that is not for the bird to say."""
        last = self.step == self._end
        if not self.in_flight or self.finished or self.step >= self._granted + last:
            return math.inf
        return -math.inf if self._begun is None else self._begun + self.step * self._period

    @property
    def waiting_for(self) -> str:
        """What the bird needs to go on, in words."""
        if self._epoch == NEVER:
            return "the clock's first grant"
        if unknown := self._around.unknown:
            return f"the wing of {', '.join(map(bird_name, unknown))}"
        if self._reached < 0:
            unheard = np.flatnonzero(self._latest.steps < 0).tolist()
            names = [bird_name(self.neighbours[k]) for k in unheard]
            return f"the first state of {', '.join(names)}"
        if self.finished:
            return "the clock's word that the run is over"
        if math.isinf(self.due):
            return f"the clock's leave to go beyond step {self.step}"
        return f"step {self.step} to be due"

    def receive_grant(self, grant: Grant) -> list[Outgoing]:
        """Take leave to begin, and to go on as far as what is recorded allows.

        Raises FlockError where the first one is of a clock that flies something else, RunFailed
        where a new epoch begins in flight.
        """
        if self.run_id not in (0, grant.run_id):
            return self.ignore(FOREIGN)
        if grant.epoch < self._epoch:
            return self.ignore(STALE)
        if self._epoch == NEVER:
            try:
                agree(bird_name(self.bird), self._configuration, grant.terms, self._factor)
            except ValueError:
                return self.ignore(MALFORMED)
        elif grant.epoch > self._epoch + REACH:
            return self.ignore(REPEATED)
        if grant.end > self._configuration.steps or grant.step > grant.end + 1:
            return self.ignore(REPEATED)
        if grant.epoch > self._epoch:
            return self._join(grant)
        self._hear_leave(grant)
        return []

    def receive_checkpoint(self, checkpoint: Checkpoint) -> list[Outgoing]:
        """Take no notice: a free flight begins where it begins, and goes back to nothing."""
        return []

    def receive_wing(self, wing: Wing) -> list[Outgoing]:
        """Learn the geometry of a neighbour."""
        if reason := self._around.hear(wing, self.run_id):
            return self.ignore(reason)
        return self._get_ready()

    def receive_stage(self, data: bytes, sent: float = -math.inf) -> list[Outgoing]:
        """Take what a neighbour has said, at time `sent` in s, of the beginning of a step."""
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
        """Take the step that is due at time `now`, in s, if one is; return what is then to be said.

        Who is late takes one step at a time, as soon as it is asked again.
        """
        if now < self.due:
            return []
        if self._begun is None:
            self._begun = now
        lateness = now - (self._begun + self.step * self._period)
        self.late += lateness >= self._period
        self.lateness = max(self.lateness, lateness)
        out = [self._say()] if self.step else []  # the first was said by all before they began
        age = now - np.maximum(self._latest.sent, self._begun)
        self._age_max = np.maximum(self._age_max, age)
        self._feel(0)
        if self.step % self._configuration.record_every == 0:
            out += self._record(age)
        last = self.step == self._end
        self._reached = self.step
        if last or self.step + 1 >= self._granted or now >= self._reported + REPORT_EVERY:
            self._reported = now
            out.append(self._progress())
        if not last:
            for stage in range(1, STAGES):
                self._feel(stage)
        self.step += 1
        if not last and self._push():
            begin(self._own, self._mine, self._work)
        return out

    def report(self) -> list[Outgoing]:
        """Return the words of a bird that has to wait: it is there, and has come so far.

        It says its last state again, too: somebody may not have known yet whose that was.
        """
        if self._epoch == NEVER:
            return []
        return [self._progress(), *([self._said] if self._said else [])]

    def _join(self, grant: Grant) -> list[Outgoing]:
        """Be there in the grant's epoch: say so, and where one is."""
        if self._granted > 0:
            raise RunFailed(f"{bird_name(self.bird)}: {NO_WAY_BACK}")
        first = self._epoch == NEVER
        self.run_id, self._epoch = grant.run_id, grant.epoch
        self._reached = -1
        self._hear_leave(grant)
        out = [self._progress()]
        if first:
            ratio = self._configuration.span_ratio[self.bird - 1]
            out.insert(0, (Channel.WING, Wing(self.run_id, self.bird, ratio).encode()))
            self._around.recall(self.run_id)
        return [*out, self._say(), *self._get_ready()]

    def _hear_leave(self, grant: Grant) -> None:
        self._end = grant.end
        self._granted = max(self._granted, min(grant.step, grant.end))
        self.released |= grant.step > grant.end

    def _get_ready(self) -> list[Outgoing]:
        """Report, once all neighbours are known, that the flight can begin for this bird.

        One that is given leave before has come to a flight that began without it.
        """
        ready = self._around.known and self._latest.complete
        if self._reached >= 0 or self._epoch == NEVER or self._granted > 0 or not ready:
            return []
        self._feel(0)  # as will be done again; but the first time loads what is compiled
        self._reached = 0
        return [self._progress()]

    def _refused(self, message: Stage) -> str:
        """Return why what a neighbour says is ignored, or nothing."""
        members = self._configuration.members
        values = message.position, message.speed, message.circulation
        if message.run_id != self.run_id or self._epoch == NEVER:
            return FOREIGN
        if message.epoch != self._epoch:
            return STALE if message.epoch < self._epoch else REPEATED
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
        """Compute the drag at a stage of this step, and the values at the next one."""
        feel_and_move(
            STAGES * self.step + stage,
            self._configuration.dt,
            self._own,
            self._around.geometry,
            self._latest.known(self.step, stage),
            self._mine,
            self._work,
        )

    def _push(self) -> bool:
        """Apply the perturbations at the beginning of this step; return whether there are any."""
        pushes = self._pushes.get(self.step, [])
        for push in pushes:
            push.push(self._work[POSITION], self._work[SPEED])
        return bool(pushes)

    def _say(self) -> Outgoing:
        """Return the message with the state at the beginning of this step."""
        numbers = stage_numbers(self._mine[0], self._configuration.members)
        message = Stage(self.run_id, self.step, self._epoch, self.bird, 0, *numbers)
        self._said = Channel.STAGE, message.encode()
        return self._said

    def _record(self, age: FloatArray) -> list[Outgoing]:
        """Return what is recorded of this step."""
        configuration, latest = self._configuration, self._latest
        numbers = stage_numbers(self._mine[0], configuration.members)
        mine = self.run_id, self._epoch
        state = State.at(configuration, self.step, *numbers, self._work[DRAG], *mine)
        ages = Ages(
            self.run_id,
            self.step,
            self._epoch,
            self.bird,
            age,
            self._age_max,
            (self.step - latest.steps).astype(np.float64),
            self.late,
            self.lateness,
        )
        self._age_max = np.zeros_like(age)
        return [(Channel.AGES, ages.encode()), (Channel.STATE, state.encode())]

    def _progress(self) -> Outgoing:
        """Return the report of how far the bird has come; -1: here, and not yet at the start."""
        name = bird_name(self.bird)
        progress = Progress(self.run_id, self._reached, self._epoch, name, self.life)
        return Channel.PROGRESS, progress.encode()
