# SPDX-License-Identifier: Apache-2.0
"""The step protocol of one bird, as a state machine: messages in, messages out.

This module uses no ROS, no clock and no threads. A bird sends its values at an RK4 stage, waits
for the same stage of its neighbours, then computes its slopes and its values at the next stage.
Data dependence alone keeps neighbours within one stage of each other, so two slots per neighbour
hold all messages that can arrive. Repeated, late and premature messages are counted and have no
effect. If no link needs all stages, messages are exchanged only at the steps of the flock's
exchange schedule; between these a bird uses the values that it remembers.

A grant of a newer epoch rewinds the flock: the bird drops its state, waits for the checkpoint of
that epoch and continues from it. A flight begins in the same way.
"""

from __future__ import annotations

from collections import Counter

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.configuration.perturbation import Perturbation
from flock_sim.messages.rejection import FOREIGN as FOREIGN_RUN
from flock_sim.messages.topics import bird_name
from flock_sim.messages.types import Checkpoint, Grant, Wing
from flock_sim.physics.runge_kutta import STAGES
from flock_sim.protocol.checkpoints import Checkpoints
from flock_sim.protocol.motion import LockstepMotion
from flock_sim.protocol.neighbours import Listener, Neighbourhood
from flock_sim.protocol.session import Channel, Granted, Outgoing, Session
from flock_sim.protocol.stage_inbox import StageInbox
from flock_sim.protocol.stage_words import END, FOREIGN, TICK


class BirdProtocol(Listener):
    """One bird of a flock. It needs its own parameters and its neighbours' messages only.

    Pass it each message that arrives; send the messages that it returns, in order:

    >>> bird = BirdProtocol(1, FlockConfiguration(birds=1, t_max=2.0, record_every=1))
    >>> out = bird.receive_grant(Grant(run_id=7, step=0, end=2, dt=1.0, epoch=1))
    >>> out += bird.receive_checkpoint(Checkpoint.of_start(run_id=7, epoch=1))
    >>> out += bird.receive_grant(Grant(run_id=7, step=2, end=2, dt=1.0, epoch=1))
    >>> [channel.value for channel, _ in out if channel is not Channel.STAGE]
    ['wing', 'progress', 'state', 'progress', 'state', 'progress', 'state', 'progress']
    """

    def __init__(
        self,
        bird: int,
        configuration: FlockConfiguration,
        run_id: int = 0,
        incarnation: int = 0,
    ) -> None:
        """Place bird 1..N at its start. `run_id` 0: the run of the first grant received.

        `incarnation` distinguishes this process of the bird from earlier ones.
        """
        self.bird = bird
        self.ignored_for = Counter()
        self.ignored = 0
        self._configuration = configuration
        self._session = Session(bird_name(bird), configuration, run_id, incarnation)
        self._granted = Granted()
        self.in_flight = False
        """Whether this bird exchanges stages: the checkpoint and every wing are known."""
        self._start = 0  # the step of the checkpoint; -1 if its state is not on disk
        self._began = 0  # the tick at which this bird began the epoch
        self._waits = 0  # reports of this bird while its epoch had begun without it
        self._held = False  # at a step's beginning, own values known, not granted
        self._pushes: dict[int, list[Perturbation]] = {}  # of this bird, by step
        self._checkpoints = Checkpoints(bird, configuration, self._session)
        self._around = Neighbourhood(bird, configuration)
        schedule = configuration.link_table.exchange_schedule
        self._inbox = StageInbox(self._around.birds, configuration.members, schedule, run_id, bird)
        self._motion = LockstepMotion(bird, configuration, self._around, self._inbox)
        self.words = self._inbox.words
        """The words that the compiled exchange continues from; see `protocol/stage_words.py`."""
        self.outbox = self._motion.outbox
        """Its last two stage messages, one for each side: the compiled exchange sends them."""
        self.only_exchanges = self._motion.only_exchanges
        """Whether most stages need no more than the exchange of messages."""

    @property
    def step(self) -> int:
        """The current step."""
        return self.tick // STAGES

    @property
    def tick(self) -> int:
        """The current tick: 4 step + stage."""
        return self._inbox.word[TICK]

    @property
    def _reached(self) -> int:
        """The last step begun with all neighbours' values known; -1: none in this epoch."""
        tick = self.tick + self._held
        return (tick - 1) // STAGES if self.in_flight and tick > self._began else -1

    @property
    def finished(self) -> bool:
        """Whether the last step is reached and its state is sent, or the run has ended."""
        return self.released or (self._held and self.step >= self._session.end)

    @property
    def missing(self) -> list[int]:
        """The neighbours whose message for this stage has not arrived; none while it is held."""
        return self._inbox.lacking

    @property
    def waiting_for(self) -> str:
        """What the bird needs to continue, as text."""
        if self._granted.step < 0:
            return "the clock's first grant"
        if unknown := self._around.unknown:
            return f"the wing of {', '.join(map(bird_name, unknown))}"
        if not self.in_flight and self._checkpoints.now is None:
            return "the checkpoint to continue from (sent by the recorder, or else the clock)"
        if not self.in_flight:
            return "a new epoch from the clock: this one began without the bird"
        if self.finished:
            return "the clock's message that the run is over"
        if self._held:
            return f"the clock's grant beyond step {self.step}"
        stage = f"stage {self.tick % STAGES} of step {self.step}"
        return f"{stage} from {', '.join(map(bird_name, self.missing))}"

    def receive_checkpoint(self, checkpoint: Checkpoint) -> list[Outgoing]:
        """Store the checkpoint that an epoch begins from, and begin the epoch if possible."""
        if reason := self._checkpoints.take(checkpoint):
            return self.ignore(reason)
        return self._begin()

    def receive_wing(self, wing: Wing) -> list[Outgoing]:
        """Store the wing of a neighbour, and begin the epoch if possible."""
        if reason := self._around.hear(wing, self.run_id):
            return self.ignore(reason)
        return self._begin()

    def receive_stage(self, data: bytes) -> list[Outgoing]:
        """Take the stage message of a neighbour in serialised form."""
        if reason := self._inbox.take(data):
            return self.ignore(reason)
        return self.advance()

    def advance(self) -> list[Outgoing]:
        """Continue, stage by stage, as far as the messages and the grant allow."""
        out: list[Outgoing] = []
        complete = self.in_flight and self._inbox.complete
        if not complete:
            return out
        while complete:
            tick = self.tick
            step, stage = divmod(tick, STAGES)
            if not self._held:
                self._motion.advance(tick)
            if stage == 0 and not self._held:
                out += self._reports(step)
            self._held = stage == 0 and step >= self._granted.step
            if self._held:
                break
            if stage + 1 == STAGES:
                self._push(step + 1)
            if self._inbox.turn():
                out.append((Channel.STAGE, self._motion.say()))
                complete = self._inbox.complete
        if self._held or not self.on_fast_path:
            self._plan()
        return out

    def report(self) -> list[Outgoing]:
        """Return the messages of a waiting bird: its progress and its last two stages.

        A neighbour can lack no other stages. So a message that the middleware loses costs time,
        but does not stop the flock.
        """
        if self._granted.step < 0:
            return []  # no run is known yet
        self._session.hear_nothing()
        if self._begun_without_it:
            self._waits += 1
            if self._waits.bit_count() == 1:  # ever more rarely: another process may fly this bird
                self._session.reincarnate()
        self._plan()
        return [self._progress(self._reached), *self.last_said]

    @property
    def last_said(self) -> list[Outgoing]:
        """The last two stages sent in this epoch, the later one last."""
        return [(Channel.STAGE, data) for data in self._motion.last_said]

    def count_foreign(self) -> None:
        """Count the messages of other runs that the compiled exchange has ignored."""
        for _ in range(self._inbox.word[FOREIGN]):
            self.ignore(FOREIGN_RUN)
        self._inbox.word[FOREIGN] = 0

    def check(self) -> None:
        """Raise RunFailed if a law of the forcing has failed in this step."""
        self._motion.check(self.tick)

    @property
    def on_fast_path(self) -> bool:
        """Whether this tick needs no more than the exchange of messages."""
        return self._inbox.word[TICK] < self._inbox.word[END]

    def _plan(self) -> None:
        """Set the tick from which on this object has more to do than to exchange messages."""
        if not self.only_exchanges:
            return
        end = 0
        if self.in_flight and not (self.released or self._held):
            every = self._configuration.record_every
            end = self._granted.next_event(self.tick, every, self._pushes)
        self._inbox.word[END] = end

    def _join(self, grant: Grant, first: bool) -> list[Outgoing]:
        """Drop the current epoch, and wait for the checkpoint of the grant's epoch."""
        run_id, epoch = self._session.now
        self._checkpoints.forget_old()
        self.in_flight = self._held = False
        self._start = -1
        self._inbox.close(run_id, epoch)
        self._granted.extend(min(grant.step, grant.end), self.step)
        out = [self._progress(-1)]
        if first:
            ratio = self._configuration.span_ratio[self.bird - 1]
            out.insert(0, (Channel.WING, Wing(run_id, self.bird, ratio).encode()))
            self._around.recall(run_id)
        return out + self._begin()

    def _extend(self, grant: Grant) -> list[Outgoing]:
        """Continue as far as a grant of this epoch allows."""
        if grant.step <= self._granted.step:
            return []
        self._granted.extend(min(grant.step, self._session.end), self.step)
        out = self.advance() if self._held else []
        self._plan()
        return out

    @property
    def _begun_without_it(self) -> bool:
        """Whether a grant goes beyond the checkpoint before this bird has begun the epoch.

        The grant is for an earlier incarnation of this bird, or it is forged.
        """
        checkpoint = self._checkpoints.now
        return (
            not self.in_flight and checkpoint is not None and self._granted.step > checkpoint.step
        )

    def _begin(self) -> list[Outgoing]:
        """Once the checkpoint and every wing are known, begin the epoch: send the first stage."""
        checkpoint = self._checkpoints.now
        if self.in_flight or not self._around.known or checkpoint is None or self._begun_without_it:
            return []
        self.in_flight = self._session.flying = True
        self._pushes = self._checkpoints.pushes(checkpoint)
        self._began = STAGES * checkpoint.step
        self._motion.learn_geometry()
        self._motion.begin(checkpoint)
        if len(checkpoint.position):
            self._start = checkpoint.step  # a recorded state includes the pushes of its step
        else:
            self._push(0)
        due = self._inbox.open(self._began)
        self._granted.extend(self._granted.step, self.step)
        return [*([(Channel.STAGE, self._motion.say())] if due else []), *self.advance()]

    def _push(self, step: int) -> None:
        """Apply the perturbations at the beginning of `step`."""
        if pushes := self._pushes.get(step):
            self._motion.push(pushes)

    def _reports(self, step: int) -> list[Outgoing]:
        """Return the messages to the recorder and the clock at the beginning of `step`."""
        out = []
        if step % self._configuration.record_every == 0 and step != self._start:
            out.append((Channel.STATE, self._motion.state(step, *self._session.now).encode()))
            if memory := self._motion.memory(step, *self._session.now):
                out.append((Channel.MEMORY, memory.encode()))
        if self._granted.reports(step):
            out.append(self._progress(step))
        return out
