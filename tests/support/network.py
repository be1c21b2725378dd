# SPDX-License-Identifier: Apache-2.0
"""A simulated network of a flock: every message waits until the test delivers it.

`Network` checks the invariants of a flight at every moment. `expected_states` returns the states
that must have been flown at the end.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum
from random import Random

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.messages.topics import bird_name
from flock_sim.messages.types import Checkpoint, Grant, Memory, Progress, Stage, State, Wing
from flock_sim.physics.runge_kutta import STAGES
from flock_sim.protocol.bird import BirdProtocol
from flock_sim.protocol.session import Channel
from flock_sim.reference.integrator import Reference

RUN, EPOCH = 7, 3
CLOCK = 0


class Kind(Enum):
    """The kind of a letter's message."""

    GRANT = "grant"
    CHECKPOINT = "checkpoint"
    WING = "wing"
    STAGE = "stage"
    PROGRESS = "progress"


@dataclass(frozen=True)
class Letter:
    """A message in flight to one receiver: a bird, or the clock."""

    kind: Kind
    to: int
    data: bytes


@dataclass
class Logbook:
    """The messages of one bird that the network has seen."""

    tick: int = -1  # of the last stage sent
    limit: int = -1  # highest step granted in a message that was delivered
    wings_sent: int = 0
    states: list[bytes] = field(default_factory=list)
    heard: set[tuple[int, int]] = field(default_factory=set)  # (neighbour, tick) delivered


class Network:
    """Birds, and a clock that grants `window` steps beyond the slowest bird."""

    def __init__(self, configuration: FlockConfiguration, window: int, run_id: int = 0) -> None:
        """Queue the first grant and the checkpoint of the start of run RUN for all birds."""
        self.configuration = configuration
        self.window = window
        self.birds = {
            bird: BirdProtocol(bird, configuration, run_id)
            for bird in range(1, configuration.birds + 1)
        }
        self.log = {bird: Logbook() for bird in self.birds}
        self.in_flight: list[Letter] = []
        self.delivered: list[Letter] = []
        self._seen: set[Letter] = set()
        self._reached = dict.fromkeys(map(bird_name, self.birds), -1)
        self._granted = -1
        self._grant(0)
        start = Checkpoint.of_start(RUN, EPOCH).encode()
        self.in_flight += [Letter(Kind.CHECKPOINT, bird, start) for bird in self.birds]

    @property
    def finished(self) -> bool:
        """Whether every bird has finished."""
        return all(bird.finished for bird in self.birds.values())

    def deliver(self, at: int) -> None:
        """Deliver a letter in flight."""
        letter = self.in_flight.pop(at % len(self.in_flight))
        self.delivered.append(letter)
        self.hand_over(letter)

    def deliver_all(self, order: Random | None = None) -> None:
        """Deliver all messages and their consequences, first in first out or in random order."""
        while self.in_flight:
            self.deliver(order.randrange(len(self.in_flight)) if order else 0)

    def hand_over(self, letter: Letter) -> None:
        """Let the receiver take a letter, which may be a duplicate."""
        again = letter in self._seen
        self._seen.add(letter)
        if letter.to == CLOCK:
            self._hear_progress(Progress.decode(letter.data))
            return

        bird, log = self.birds[letter.to], self.log[letter.to]
        before = bird.ignored
        if letter.kind is Kind.GRANT:
            grant = Grant.decode(letter.data)
            stale = grant.step <= log.limit
            log.limit = max(log.limit, grant.step)
            sent = bird.receive_grant(grant)
            assert not (stale and sent), "a stale grant moved a bird"
            assert bird.ignored == before
        elif letter.kind is Kind.CHECKPOINT:
            sent = bird.receive_checkpoint(Checkpoint.decode(letter.data))
            assert not (again and sent), "a checkpoint that was known moved a bird"
            assert bird.ignored == before + again
        elif letter.kind is Kind.WING:
            sent = bird.receive_wing(Wing.decode(letter.data))
            assert not (again and sent), "a wing that was known moved a bird"
            assert bird.ignored == before
        else:
            stage = Stage.decode(letter.data)
            log.heard.add((stage.bird, STAGES * stage.step + stage.stage))
            sent = bird.receive_stage(letter.data)
            assert not (again and sent), "a stage heard before moved a bird"
            assert bird.ignored == before + again, "every genuine stage counts, and counts once"
        self._send(letter.to, sent)

    def say_again(self, sender: int) -> None:
        """Let a bird send the report that it sends every second while it waits."""
        for channel, data in self.birds[sender].report():
            if channel is Channel.STAGE:
                self._to_listeners(Kind.STAGE, sender, data)
            else:
                self.in_flight.append(Letter(Kind.PROGRESS, CLOCK, data))

    def hand_over_forgery(self, to: int, data: bytes) -> None:
        """Let a bird take a forged stage message: it is counted, without another effect.

        Before the bird has started, it may also keep the message, for a start that never comes.
        """
        bird = self.birds[to]
        before = bird.ignored
        assert bird.receive_stage(data) == []
        assert bird.ignored == before + 1 or (not bird.in_flight and bird.ignored == before)

    def _send(self, sender: int, out: list[tuple[Channel, bytes]]) -> None:
        for channel, data in out:
            {
                Channel.WING: self._send_wing,
                Channel.STAGE: self._send_stage,
                Channel.STATE: self._send_state,
                Channel.MEMORY: self._send_memory,
                Channel.PROGRESS: self._send_progress,
            }[channel](sender, data)

    def _send_wing(self, sender: int, data: bytes) -> None:
        wing = Wing.decode(data)
        assert (wing.run_id, wing.bird) == (RUN, sender)
        self.log[sender].wings_sent += 1
        assert self.log[sender].wings_sent == 1
        self._to_listeners(Kind.WING, sender, data)

    def _send_memory(self, sender: int, data: bytes) -> None:
        memory = Memory.decode(data)
        assert (memory.run_id, memory.epoch, memory.bird) == (RUN, EPOCH, sender)
        assert memory.step == State.step_of(self.log[sender].states[-1])

    def _send_stage(self, sender: int, data: bytes) -> None:
        log, stage = self.log[sender], Stage.decode(data)
        tick = STAGES * stage.step + stage.stage
        assert (stage.run_id, stage.epoch, stage.bird) == (RUN, EPOCH, sender)
        assert stage.encode() == data, "a stage is a BirdStage to the last byte"
        exchange_schedule = self.configuration.link_table.exchange_schedule
        assert tick == exchange_schedule.after(log.tick), "each stage once, in order"
        if tick:
            self._assert_has_heard(sender, log.tick)
            assert (tick - 1) // STAGES < log.limit, "a bird went on without leave"
        log.tick = tick
        for other in self.birds[sender].neighbours:
            behind = min(tick, self.log[other].tick)
            ahead = max(tick, self.log[other].tick)
            assert ahead <= exchange_schedule.after(behind), "neighbours drifted apart"
        self._to_listeners(Kind.STAGE, sender, data)

    def _send_state(self, sender: int, data: bytes) -> None:
        log, state = self.log[sender], State.decode(data)
        assert state.step == len(log.states) * self.configuration.record_every
        assert state.step <= log.limit, "a state beyond what was granted"
        exchange_schedule = self.configuration.link_table.exchange_schedule
        assert log.tick <= STAGES * state.step < exchange_schedule.after(log.tick), (
            "a state goes out at the beginning of its step"
        )
        self._assert_has_heard(sender, log.tick)
        assert State.envelope(data) == (RUN, EPOCH)
        log.states.append(State.opened(data))

    def _send_progress(self, sender: int, data: bytes) -> None:
        progress, log = Progress.decode(data), self.log[sender]
        assert (progress.run_id, progress.epoch) == (RUN, EPOCH)
        assert progress.who == bird_name(sender)
        assert progress.step <= log.limit
        # All states due up to this step are sent, because the recorder may wait for them.
        assert len(log.states) == progress.step // self.configuration.record_every + 1
        self.in_flight.append(Letter(Kind.PROGRESS, CLOCK, data))

    def _assert_has_heard(self, bird: int, tick: int) -> None:
        for other in self.birds[bird].neighbours:
            assert (other, tick) in self.log[bird].heard, "a bird went on with a message missing"

    def _to_listeners(self, kind: Kind, sender: int, data: bytes) -> None:
        for listener, bird in self.birds.items():
            if sender in bird.neighbours:
                self.in_flight.append(Letter(kind, listener, data))

    def _hear_progress(self, progress: Progress) -> None:
        self._reached[progress.who] = max(self._reached[progress.who], progress.step)
        slowest = min(self._reached.values())
        if slowest >= 0:
            self._grant(min(slowest + self.window, self.configuration.steps))

    def _grant(self, step: int) -> None:
        if step <= self._granted:
            return
        self._granted = step
        grant = Grant(RUN, step, self.configuration.steps, self.configuration.dt, EPOCH)
        for bird in self.birds:
            self.in_flight.append(Letter(Kind.GRANT, bird, grant.encode()))


def expected_states(configuration: FlockConfiguration) -> dict[int, list[bytes]]:
    """Return the states of every bird of the reference flight, encoded as in a bag."""
    states: dict[int, list[bytes]] = {bird: [] for bird in range(1, configuration.birds + 1)}
    for flock in Reference(configuration).fly():
        for bird, state in enumerate(State.of_flock(configuration, flock), 1):
            states[bird].append(state.encode())
    return states
