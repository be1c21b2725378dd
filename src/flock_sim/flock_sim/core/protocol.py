# SPDX-License-Identifier: Apache-2.0
"""The step protocol of one bird, as a state machine: messages in, messages out.

No ROS, no clock, no threads. A bird sends its values at an RK4 stage, waits for the same stage of
its neighbours, computes its slopes and so its values at the next stage. Data dependence alone
keeps neighbours within one stage of each other, so two slots per neighbour hold all that can
arrive; what comes twice, late or too early is counted and changes nothing. Where no link needs all
stages, messages are exchanged at the steps of the flock's timetable only, and between these a bird
goes by what it remembers.

A grant of a newer epoch sends everybody back: the bird forgets where it is, waits for the
checkpoint of that epoch and goes on from there. That is how a flight begins, too.
"""

from __future__ import annotations

from collections import Counter, deque
from enum import Enum

import numpy as np

from flock_sim.core import formation
from flock_sim.core.bird_step import (
    DRAG,
    POSITION,
    SPEED,
    WORK_ROWS,
    StageKernel,
    begin,
    constants,
    feel_and_move,
)
from flock_sim.core.configuration import FlockConfiguration
from flock_sim.core.kernel import FloatArray
from flock_sim.core.leg import Leg
from flock_sim.core.links.receiver import Receiver
from flock_sim.core.listener import Listener
from flock_sim.core.messages import Checkpoint, Grant, Memory, Progress, State, Wing
from flock_sim.core.neighbourhood import Neighbourhood
from flock_sim.core.perturbation import Perturbation, perturbations
from flock_sim.core.runge_kutta import STAGES
from flock_sim.core.scaling import Scales
from flock_sim.core.stage_inbox import (
    FOREIGN,
    IMPOSSIBLE,
    MALFORMED,
    NEVER,
    REACH,
    REPEATED,
    STALE,
    StageInbox,
)
from flock_sim.core.stage_message import (
    HEADER,
    HEADER_AT,
    stage_bytes,
    stage_numbers,
    stage_words,
)
from flock_sim.core.steering import Control, Steering
from flock_sim.core.terms import agree
from flock_sim.core.topics import bird_name
from flock_sim.errors import FlockError

EARLY = 16
"""Checkpoints of runs not known to be ours that are kept."""


class Channel(Enum):
    """Where a message of a bird goes."""

    __hash__ = object.__hash__  # as good as Enum's, and not written in Python: one a message

    WING = "wing"
    STAGE = "stage"
    STATE = "state"
    MEMORY = "memory"
    AGES = "ages"
    PROGRESS = "progress"


Outgoing = tuple[Channel, bytes]


class BirdProtocol(Listener):
    """One bird of a flock, flying by its own parameters and its neighbours' messages only.

    Feed it what arrives; send what it returns, in order:

    >>> bird = BirdProtocol(1, FlockConfiguration(birds=1, t_max=2.0, record_every=1))
    >>> out = bird.receive_grant(Grant(run_id=7, step=0, end=2, dt=1.0, epoch=1))
    >>> out += bird.receive_checkpoint(Checkpoint.of_start(run_id=7, epoch=1))
    >>> out += bird.receive_grant(Grant(run_id=7, step=2, end=2, dt=1.0, epoch=1))
    >>> [channel.value for channel, _ in out if channel is not Channel.STAGE]
    ['wing', 'progress', 'state', 'progress', 'state', 'progress', 'state', 'progress']
    """

    _feel_and_move: StageKernel = staticmethod(feel_and_move)

    def __init__(
        self,
        bird: int,
        configuration: FlockConfiguration,
        run_id: int = 0,
        life: int = 0,
        control: Control | None = None,
        stage_kernel: StageKernel | None = None,
    ) -> None:
        """Place bird 1..N at its start. `run_id` 0: that of the first grant heard.

        `life` tells this bird from those who were it before, if its process is not the first;
        `control` gives a force besides those that all birds feel. `stage_kernel` takes the
        place of `feel_and_move`, and does the same: a stopwatch may be around it.
        """
        # CPython reads attributes slower where an object has more than 30 of them: a bird would
        # take a twentieth longer for a step.
        self.bird = bird
        self.run_id = run_id
        self.life = life
        self.released = False
        """Whether the clock has said that the run is over, and nobody needs this bird any more."""
        self.ignored_for = Counter()
        self.ignored = 0
        self._configuration = configuration
        self._epoch = NEVER  # of no message: nothing is taken before the first grant
        self._end = configuration.steps
        self._granted = -1
        self._checkpoint: Checkpoint | None = None  # of this epoch or of one to come
        self._early: dict[int, Checkpoint] = {}  # by run, before it is known which is ours
        self._flying = False  # in this epoch: at the checkpoint, and every wing known
        self._start = 0  # the step of the checkpoint; -1 where its state is not on disk
        self._report_at = 0
        self._reached = -1  # the last step whose beginning was reached, its neighbours heard
        self._tick = 0  # 4 step + stage, of the last message sent
        self._said: deque[Outgoing] = deque(maxlen=2)  # the last stages sent in this epoch
        self._held = False  # at the beginning of a step, its own values known, no leave to go on
        self._pushes: dict[int, list[Perturbation]] = {}  # of this bird, by step

        members = configuration.members
        self._members = members
        self._dt = configuration.dt
        self._own = constants(bird, configuration)
        self._around = Neighbourhood(bird, configuration)
        linkage = configuration.linkage
        self._steering = (
            Steering(bird, control, self._own, self._around.birds, configuration)
            if control
            else None
        )
        self._inbox = StageInbox(self._around.birds, members, linkage.timetable, run_id)
        self._receiver = Receiver(bird, configuration) if linkage.remembers(bird) else None
        self._mine = np.zeros((2, stage_words(members)))
        self.outbox = [stage_bytes(self._mine[side], members) for side in range(2)]
        """Its last two stage messages: at even ticks and at odd ones."""
        self._work = np.zeros((WORK_ROWS, members))
        if stage_kernel is not None:
            self._feel_and_move = stage_kernel

    @property
    def step(self) -> int:
        """The step being taken."""
        return self._tick // STAGES

    @property
    def in_flight(self) -> bool:
        """Whether stages are exchanged."""
        return self._flying

    @property
    def finished(self) -> bool:
        """Whether the last step is reached and its state is out, or the run is over anyhow."""
        return self.released or (self._held and self.step >= self._end)

    @property
    def missing(self) -> list[int]:
        """The neighbours whose message for this stage is not here yet; none while it is held."""
        return list(self._inbox.lacking.values())

    @property
    def waiting_for(self) -> str:
        """What the bird needs to go on, in words."""
        if self._granted < 0:
            return "the clock's first grant"
        if unknown := self._around.unknown:
            return f"the wing of {', '.join(map(bird_name, unknown))}"
        if not self._flying and self._checkpoint is None:
            return "the checkpoint to go on from (the recorder's, or the clock's if none records)"
        if not self._flying:
            return "the clock to begin anew: this epoch was begun without it"
        if self.finished:
            return "the clock's word that the run is over"
        if self._held:
            return f"the clock's leave to go beyond step {self.step}"
        stage = f"stage {self._tick % STAGES} of step {self.step}"
        return f"{stage} from {', '.join(map(bird_name, self.missing))}"

    def receive_grant(self, grant: Grant) -> list[Outgoing]:
        """Take leave to go on, or hear that a new epoch begins.

        Raises FlockError where the first one is of a clock that flies something else.
        """
        if self.run_id not in (0, grant.run_id):
            return self.ignore(FOREIGN)
        if grant.epoch < self._epoch:
            return self.ignore(STALE)
        if self._epoch == NEVER:
            try:
                self._agree(grant)
            except ValueError:
                return self.ignore(MALFORMED)
        if grant.end > self._configuration.steps or grant.step > grant.end + 1:
            return self.ignore(REPEATED)
        if grant.epoch > self._epoch:
            return self._join(grant)
        self._end = min(self._end, grant.end)
        self.released |= grant.step > self._end
        if grant.step <= self._granted:
            return []
        self._grant(grant.step)
        return self._advance() if self._held else []

    def receive_checkpoint(self, checkpoint: Checkpoint) -> list[Outgoing]:
        """Take note of where an epoch begins."""
        if self.run_id not in (0, checkpoint.run_id):
            return self.ignore(FOREIGN)
        if checkpoint.epoch < self._epoch:
            return self.ignore(STALE)
        held = self._checkpoint if self.run_id else self._early.get(checkpoint.run_id)
        known = held is not None and held.epoch >= checkpoint.epoch
        if known or not self._fits(checkpoint):
            return self.ignore(REPEATED if known else IMPOSSIBLE)
        if self.run_id:
            self._checkpoint = checkpoint
            return self._begin()
        self._early[checkpoint.run_id] = checkpoint
        if len(self._early) <= EARLY:
            return []
        del self._early[next(iter(self._early))]  # the oldest, which now is the one that is ignored
        return self.ignore(FOREIGN)

    def receive_wing(self, wing: Wing) -> list[Outgoing]:
        """Learn the geometry of a neighbour."""
        if reason := self._around.hear(wing, self.run_id):
            return self.ignore(reason)
        return self._begin()

    def receive_stage(self, data: bytes) -> list[Outgoing]:
        """Take the stage message of a neighbour, as it came off the wire."""
        if reason := self._inbox.take(data):
            return self.ignore(reason)
        return [] if self._inbox.lacking or not self._flying else self._advance()

    def report(self) -> list[Outgoing]:
        """Return the words of a bird that has to wait: it is there, and has come so far.

        It says its last two stages again, too: those are all that a neighbour may lack. A message
        that the middleware has lost costs time, and does not stop a flock.
        """
        if self._granted < 0:
            return []  # there is no run yet to report to
        return [self._progress(self._reached), *self._said]

    def leg(self) -> Leg | None:
        """Return a leg for this bird; None if it does more at a stage than to exchange it."""
        inbox = self._inbox
        plain = self._feel_and_move is feel_and_move and inbox.every_tick
        if self._receiver or self._steering or not plain:
            return None
        arrays = (self._own, self._around.geometry, inbox.heard, self._mine, self._work)
        return Leg(self.bird, self._around.birds, self._members, arrays)

    def embark(self, leg: Leg) -> bool:
        """Leave the stages up to the next step with more to do to `leg`; False if there are none.

        Until it lands, the bird itself knows nothing of what is flown, and is not to be asked.
        """
        if self.released or self._held or not self._flying:
            return False
        end = STAGES * self._next_event()
        if self._tick >= end:
            return False
        leg.begin(self._tick, end, self.run_id, self._epoch, self._inbox.lacking_by_side)
        return True

    def land(self, leg: Leg) -> list[Outgoing]:
        """Go on by itself from where `leg` is."""
        for _ in range(leg.foreign):
            self.ignore(FOREIGN)
        inbox, tick = self._inbox, leg.tick
        if tick > self._tick:
            self._reached = max(self._reached, (tick - 1) // STAGES)
            self._said.append(self._said_at(tick - 1))
            if not leg.over:
                self._said.append(self._said_at(tick))
        self._tick = tick - leg.over
        inbox.go_to(self._tick, leg.lacking)
        if not leg.over:
            return []
        out = self._turn()
        return out if inbox.lacking else out + self._advance()

    def _said_at(self, tick: int) -> Outgoing:
        """Return what was said at one of the last two ticks."""
        return Channel.STAGE, bytes(self.outbox[tick & 1])

    def _next_event(self) -> int:
        """Return the next step at whose beginning there is more to do than to exchange a stage."""
        step, every = -(-self._tick // STAGES), self._configuration.record_every
        events = [self._granted, -(-step // every) * every, self._report_at, *self._pushes]
        return min(event for event in events if event >= step)

    def _agree(self, grant: Grant) -> None:
        """Raise FlockError where the clock flies something else."""
        configuration = self._configuration
        if grant.terms:
            agree(bird_name(self.bird), configuration, grant.terms)
        elif grant.dt != configuration.dt or grant.end != configuration.steps:
            raise FlockError(
                f"the clock flies {grant.end} steps of dt = {grant.dt:g} and "
                f"{bird_name(self.bird)} {configuration.steps} of {configuration.dt:g}: "
                "give both the same configuration"
            )

    def _join(self, grant: Grant) -> list[Outgoing]:
        """Leave everything, and wait for the checkpoint of the grant's epoch."""
        first = self._epoch == NEVER
        if not first and grant.epoch > self._epoch + REACH:
            return self.ignore(REPEATED)
        if not self.run_id:
            self._checkpoint = self._early.get(grant.run_id)
            self._early = {}
        self.run_id, self._epoch = grant.run_id, grant.epoch
        self._end = grant.end
        self.released = grant.step > grant.end
        self._flying = self._held = False
        self._reached = self._start = -1
        self._said.clear()
        self._inbox.close(self.run_id, self._epoch)
        self._grant(grant.step)
        out = [self._progress(-1)]
        if first:
            ratio = self._configuration.span_ratio[self.bird - 1]
            out.insert(0, (Channel.WING, Wing(self.run_id, self.bird, ratio).encode()))
            self._around.recall(self.run_id)
        return out + self._begin()

    def _grant(self, step: int) -> None:
        step = min(step, self._end)
        self._granted = step
        # Ask for more half way, so that leave comes before it runs out.
        self._report_at = self.step + max(1, (step - self.step) // 2)

    def _fits(self, checkpoint: Checkpoint) -> bool:
        """Whether a checkpoint can be one of this flight."""
        configuration = self._configuration
        size = len(checkpoint.position)
        try:
            self._pushes_of(checkpoint)
        except FlockError:
            return False
        return (
            size == len(checkpoint.speed)
            and size in (0, configuration.birds * self._members)
            and checkpoint.step <= (configuration.steps if size else 0)
            and checkpoint.step % configuration.record_every == 0
            and len(checkpoint.memory)
            == (configuration.linkage.memory_ends[-1] * self._members if size else 0)
        )

    def _begin(self) -> list[Outgoing]:
        """Begin the epoch once its checkpoint and every wing are known: send the first stage."""
        checkpoint = self._checkpoint
        if (
            self._flying
            or not self._around.known
            or checkpoint is None
            or checkpoint.epoch != self._epoch
            or self._granted > checkpoint.step  # by a former life of this bird: there will be a new
        ):
            return []
        self._flying = True
        self._pushes = self._pushes_of(checkpoint)
        self._tick = STAGES * checkpoint.step
        if len(checkpoint.position):
            self._start = checkpoint.step
            mine = slice((self.bird - 1) * self._members, self.bird * self._members)
            self._work[POSITION], self._work[SPEED] = (
                checkpoint.position[mine],
                checkpoint.speed[mine],
            )
        else:
            self._work[POSITION] = formation.start_position(self.bird, self._configuration.birds)
            self._work[SPEED] = Scales.of(self._configuration).cruise_speed
        begin(self._own, self._mine, self._work)
        if self._receiver:
            self._receiver.begin(checkpoint.memory)
        self._grant(self._granted)
        out = [self._stage()] if self._inbox.open(self._tick) else []
        return out if self._inbox.lacking else out + self._advance()

    def _pushes_of(self, checkpoint: Checkpoint) -> dict[int, list[Perturbation]]:
        """Return the pushes that are for this bird, by step, in their order.

        Raises FlockError where the checkpoint asks for what the flight has not.
        """
        configuration = self._configuration
        live = perturbations(
            checkpoint.perturbations.split(),
            configuration.birds,
            configuration.members,
            configuration.steps,
        )
        pushes: dict[int, list[Perturbation]] = {}
        for push in (*configuration.pushes, *live):
            if push.bird == self.bird:
                pushes.setdefault(push.step, []).append(push)
        return pushes

    def _push(self, step: int) -> bool:
        """Apply the perturbations at the beginning of `step`; return whether there are any."""
        for push in self._pushes.get(step, []):
            push.push(self._work[POSITION], self._work[SPEED])
        return step in self._pushes

    def _stage(self) -> Outgoing:
        """Return the message with this tick's values."""
        step, stage = divmod(self._tick, STAGES)
        side = self.outbox[self._tick & 1]
        HEADER.pack_into(
            side, HEADER_AT, self.run_id, step, self._epoch, self.bird, stage, self._members
        )
        said = self._said_at(self._tick)
        self._said.append(said)
        return said

    def _advance(self) -> list[Outgoing]:
        """Go on, stage by stage, as far as messages and leave allow."""
        out: list[Outgoing] = []
        inbox = self._inbox
        while not inbox.lacking:
            tick = self._tick
            stage = tick % STAGES
            if not self._held:
                heard = inbox.heard
                if self._receiver is not None or self._steering is not None:
                    heard = self._listen(heard)
                self._feel_and_move(
                    tick, self._dt, self._own, self._around.geometry, heard, self._mine, self._work
                )
            if stage == 0:
                step = tick // STAGES
                if not self._held:
                    out += self._reports(step, self._mine[tick & 1])
                self._held = step >= self._granted
                if self._held:
                    break
            out += self._turn()
        return out

    def _turn(self) -> list[Outgoing]:
        """Go on to the next tick, whose values are computed; return what is sent at it."""
        self._tick = tick = self._tick + 1
        if self._pushes and tick % STAGES == 0 and self._push(tick // STAGES):
            begin(self._own, self._mine, self._work)
        return [self._stage()] if self._inbox.turn(tick) else []

    def _listen(self, heard: FloatArray) -> FloatArray:
        """Return what is known of the neighbours at this tick, after steering by it."""
        if self._receiver is not None:
            heard = self._receiver.listen(
                self._tick, self._around.geometry, heard[self._inbox.side], self._mine
            )
        if self._steering is not None:
            self._steering.steer(self._tick, heard, self._mine)
        return heard

    def _reports(self, step: int, words: FloatArray) -> list[Outgoing]:
        """Return what the recorder and the clock are to know of the beginning of `step`."""
        out = []
        if step % self._configuration.record_every == 0 and step != self._start:
            out.append((Channel.STATE, self._state(step, words).encode()))
            if self._receiver:
                data = self._receiver.memory.ravel()
                memory = Memory(self.run_id, step, self._epoch, self.bird, data)
                out.append((Channel.MEMORY, memory.encode()))
        self._reached = step
        if step >= self._granted or step == self._report_at:
            out.append(self._progress(step))
        return out

    def _progress(self, step: int) -> Outgoing:
        """Return the report of having reached `step`; -1: here, and not yet at the start."""
        progress = Progress(self.run_id, step, self._epoch, bird_name(self.bird), self.life)
        return Channel.PROGRESS, progress.encode()

    def _state(self, step: int, words: FloatArray) -> State:
        position, speed, circulation = stage_numbers(words, self._members)
        return State.at(
            self._configuration,
            step,
            position,
            speed,
            circulation,
            self._work[DRAG],
            self.run_id,
            self._epoch,
        )
