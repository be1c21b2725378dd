# SPDX-License-Identifier: Apache-2.0
"""A flock whose birds, clock and recorder die and come back, in the hands of a test.

Everything is as on ROS 2 topics that are reliable and latched, made worse: every message on its way
may be delayed, overtaken by any other and doubled. A writer keeps the last messages of each topic
for readers who come later, and takes them along when it dies; what it has in flight then arrives or
does not. A queue that is full loses its oldest message.

`World` checks what must hold at every moment; `settle` lets everything living be delivered and
checks what must come of it.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from random import Random
from typing import Any

import numpy as np

from flock_sim.core import topics
from flock_sim.core.configuration import FlockConfiguration
from flock_sim.core.ledger import Ledger, Row
from flock_sim.core.messages import (
    Checkpoint,
    Grant,
    Memory,
    Progress,
    Stage,
    State,
    Time,
    Wing,
)
from flock_sim.core.protocol import BirdProtocol, Channel, Outgoing
from flock_sim.core.runge_kutta import STAGES
from flock_sim.core.stage_inbox import NEVER
from flock_sim.core.timekeeper import Timekeeper
from flock_sim.core.topics import RECORDER, bird_name
from unit.network import expected_states

RUN = 7
CLOCK = "clock"
QUIET_ROUNDS = 4
"""Reports of everybody that may pass without any message that moves the flock: then it is stuck."""


@dataclass(eq=False)
class Queue:
    """What one process has said to another on one topic, and has not arrived."""

    sender: Process
    to: Process
    topic: str
    messages: list[bytes] = field(default_factory=list)


@dataclass(eq=False)
class Process:
    """One life of a bird, the clock or the recorder."""

    who: str
    life: int
    core: Any
    hears: dict[str, Callable[[bytes], None]] = field(default_factory=dict)
    latched: dict[str, deque[bytes]] = field(default_factory=dict)


class Disk:
    """What the recorder has put on disk; it outlives it."""

    def __init__(self) -> None:
        self.rows: list[Row] = []

    @property
    def saved(self) -> int:
        return self.rows[-1].step if self.rows else -1


class Recorder:
    """The recorder without ROS and without a bag: a Ledger, and a disk that is flushed at times."""

    def __init__(self, world: World, life: int) -> None:
        self.ledger = Ledger(world.configuration, world.stages, world.disk.saved)
        self.joined = False
        self.released = False
        self._world = world
        self._life = life
        self._epoch = NEVER
        self._written: list[Row] = []

    def hear_grant(self, grant: Grant) -> None:
        if grant.epoch < self._epoch:
            return
        if grant.epoch > self._epoch:
            self._epoch = grant.epoch
            self._flush()
            self.ledger.begin(RUN, grant.epoch)
            self.joined = False
        self.released |= grant.step > grant.end
        self.ledger.end_at(grant.end)

    def join(self) -> None:
        """Say where the epoch begins, once every bird's topics are found."""
        if self._epoch == NEVER or self.joined:
            return
        if self.ledger.complete or self._world.all_birds_live:
            self.joined = True
            self._world.publish(RECORDER, topics.CHECKPOINT_TOPIC, self._checkpoint().encode())
            self.report()

    def write(self, rows: Iterable[Row]) -> None:
        self._written += rows

    def keep_safe(self) -> None:
        if self._written:
            self._flush()
            self.report()

    def report(self) -> None:
        if self.joined:
            saved = Progress(RUN, self._world.disk.saved, self._epoch, RECORDER, self._life)
            self._world.publish(RECORDER, topics.PROGRESS_TOPIC, saved.encode())

    def _flush(self) -> None:
        self._world.put_on_disk(self._written)
        self._written = []

    def _checkpoint(self) -> Checkpoint:
        disk = self._world.disk
        if not disk.rows:
            return Checkpoint.of_start(RUN, self._epoch)
        states = [State.decode(data) for data in disk.rows[-1].states]
        return Checkpoint(
            RUN,
            disk.saved,
            self._epoch,
            np.concatenate([state.position for state in states]),
            np.concatenate([state.speed for state in states]),
            memory=np.concatenate(
                [np.empty(0), *(Memory.decode(data).data for data in disk.rows[-1].memories)]
            ),
        )


class World:
    """A flock and all who serve it; nobody is there until `bring` brings them."""

    def __init__(
        self,
        configuration: FlockConfiguration,
        window: int,
        random: Random,
        *,
        record: bool = True,
        stages: bool = False,
    ) -> None:
        self.configuration = configuration
        self.window = window
        self.random = random
        self.record = record
        self.stages = stages
        self.birds = [bird_name(bird) for bird in range(1, configuration.birds + 1)]
        self.everybody = [*self.birds, CLOCK, *([RECORDER] if record else [])]
        self.living: dict[str, Process] = {}
        self.twins: list[Process] = []
        """Those who live, and whose place another has taken all the same."""
        self.queues: dict[tuple[int, int, str], Queue] = {}
        self.disk = Disk()
        self.over = False
        """Whether the clock has let everybody go: it hears nothing any more."""
        self.ordered = random.random() < 0.7
        """Whether what one writer says on one topic comes in order, as DDS has it."""
        self.stopped_at: int | None = None
        self.deaths = 0
        self._epochs = 0  # the latest that any clock has begun
        self._lives = 0
        self._states = {
            bird_name(bird): states for bird, states in expected_states(configuration).items()
        }
        self._sent: set[tuple[str, int]] = set()  # (bird, step) of every state

    # --- life and death ---

    @property
    def dead(self) -> list[str]:
        return [who for who in self.everybody if who not in self.living]

    @property
    def all_birds_live(self) -> bool:
        return all(who in self.living for who in self.birds)

    @property
    def keeper(self) -> Timekeeper:
        return self.living[CLOCK].core

    def bird(self, number: int) -> BirdProtocol:
        return self.living[bird_name(number)].core

    def bring(self, *names: str) -> None:
        """Start a process for each, a twin's if there is one: what is latched is on its way."""
        for who in names:
            self._lives += 1
            make = {CLOCK: self._clock, RECORDER: self._recorder}.get(who, self._bird)
            if who in self.living:
                self.twins.append(self.living[who])
            newcomer = self.living[who] = make(who, self._lives)
            for other in [*self.living.values(), *self.twins]:
                if other is not newcomer:
                    for topic in (name for name in newcomer.hears if name in other.latched):
                        for data in other.latched[topic]:
                            self._post(other, newcomer, topic, data)
            if who == CLOCK:
                self._say(newcomer.core.first_messages)
        self._look_around()

    def kill(self, *names: str) -> None:
        """Let some die: whatever they had in flight arrives, or does not."""
        for who in names:
            gone = self.living.pop(who)
            self.deaths += 1
            for key, queue in list(self.queues.items()):
                if queue.to is gone:
                    del self.queues[key]
                elif queue.sender is gone:
                    # Of those on their way the first ones may arrive.
                    del queue.messages[self.random.randint(0, len(queue.messages)) :]

    def _bird(self, who: str, life: int) -> Process:
        number = self.birds.index(who) + 1
        known = RUN if self.random.random() < 0.5 else 0
        bird = BirdProtocol(number, self.configuration, known, life)
        process = Process(who, life, bird)

        def hears(receive: Callable[[Any], list[Outgoing]], kind: Any) -> Callable[[bytes], None]:
            return lambda data: self._send(process, receive(kind.decode(data)))

        process.hears = {
            topics.GRANT_TOPIC: hears(bird.receive_grant, Grant),
            topics.CHECKPOINT_TOPIC: hears(bird.receive_checkpoint, Checkpoint),
        }
        for other in bird.neighbours:
            process.hears[topics.wing_topic(other)] = hears(bird.receive_wing, Wing)
            process.hears[topics.stage_topic(other)] = lambda data: self._send(
                process, bird.receive_stage(data)
            )
        return process

    def _clock(self, who: str, life: int) -> Process:
        self._epochs += self.random.randint(1, 3)
        keeper = Timekeeper(
            self.configuration, RUN, self.window, self.record, self.stages, self._epochs
        )

        def hear(data: bytes) -> None:
            if not self.over:
                self._say(keeper.receive(Progress.decode(data)))

        return Process(who, life, keeper, {topics.PROGRESS_TOPIC: hear})

    def _recorder(self, who: str, life: int) -> Process:
        recorder = Recorder(self, life)
        ledger = recorder.ledger

        def hears(add: Callable[..., list[Row]], *what: int) -> Callable[[bytes], None]:
            return lambda data: recorder.write(add(*what, data))

        process = Process(who, life, recorder)
        process.hears = {
            topics.GRANT_TOPIC: lambda data: recorder.hear_grant(Grant.decode(data)),
            topics.CLOCK_TOPIC: hears(ledger.add_time),
        }
        for bird in range(1, self.configuration.birds + 1):
            process.hears[topics.wing_topic(bird)] = hears(ledger.add_wing, bird)
            process.hears[topics.state_topic(bird)] = hears(ledger.add_state, bird)
            process.hears[topics.memory_topic(bird)] = hears(ledger.add_memory, bird)
            if self.stages:
                process.hears[topics.stage_topic(bird)] = hears(ledger.add_stage, bird)
        return process

    # --- messages ---

    def publish(self, who: str, topic: str, data: bytes) -> None:
        """Put a message on its way to all who listen now, and keep it for those to come."""
        self._publish(self.living[who], topic, data)

    def _publish(self, sender: Process, topic: str, data: bytes) -> None:
        depth = topics.depth(topic, self.configuration)
        sender.latched.setdefault(topic, deque(maxlen=depth)).append(data)
        for listener in [*self.living.values(), *self.twins]:
            if topic in listener.hears:
                self._post(sender, listener, topic, data)

    def _post(self, sender: Process, to: Process, topic: str, data: bytes) -> None:
        """Put a message on its way; a queue that is full loses its oldest, at the worst."""
        key = sender.life, to.life, topic
        queue = self.queues.setdefault(key, Queue(sender, to, topic)).messages
        queue.append(data)
        depth = topics.depth(topic, self.configuration)
        if len(queue) > depth and self.random.random() < 0.5:
            lost = queue.pop(0)
            if topic.endswith("/state") and State.envelope(lost) >= State.envelope(data):
                assert State.step_of(lost) <= self.disk.saved, "a queue lost a state"

    def _send(self, process: Process, out: list[Outgoing]) -> None:
        number = self.birds.index(process.who) + 1
        names = {
            Channel.WING: topics.wing_topic(number),
            Channel.STAGE: topics.stage_topic(number),
            Channel.STATE: topics.state_topic(number),
            Channel.MEMORY: topics.memory_topic(number),
            Channel.PROGRESS: topics.PROGRESS_TOPIC,
        }
        for channel, data in out:
            if channel is Channel.STATE:
                step = State.step_of(data)
                flown = self._states[process.who][step // self.configuration.record_every]
                assert State.opened(data) == flown, "a bit has changed"
                self._sent.add((process.who, step))
            self._publish(process, names[channel], data)

    def _say(self, messages: Iterable[Any]) -> None:
        for message in messages:
            if isinstance(message, Grant):
                self._check_leave(message)
                self._epochs = max(self._epochs, message.epoch)
            topic = {
                Grant: topics.GRANT_TOPIC,
                Time: topics.CLOCK_TOPIC,
                Checkpoint: topics.CHECKPOINT_TOPIC,
            }[type(message)]
            self.publish(CLOCK, topic, message.encode())

    def _check_leave(self, grant: Grant) -> None:
        if self.record and grant.step <= grant.end:
            ahead = topics.steps_ahead(self.configuration, self.stages)
            assert grant.step <= max(self.disk.saved, 0) + ahead, "more leave than queues can hold"

    def put_on_disk(self, rows: Iterable[Row]) -> None:
        for row in rows:
            due = 0 if self.disk.saved < 0 else self.disk.saved + self.configuration.record_every
            assert row.step == due, "rows once each, in order"
            place = row.step // self.configuration.record_every
            assert row.states == [self._states[who][place] for who in self.birds]
            assert Time.decode(row.time).stamp == self.configuration.stamp(row.step)
            if self.stages:
                self._check_stages(row)
            self.disk.rows.append(row)

    def _check_stages(self, row: Row) -> None:
        steps = range(max(0, row.step - self.configuration.record_every), row.step)
        due = self.configuration.linkage.timetable.due
        every = [STAGES * step + stage for step in steps for stage in range(STAGES)]
        ticks = [tick for tick in every if due(tick)]
        stages = [(bird, Stage.decode(data)) for bird, data in row.stages]
        assert [(STAGES * s.step + s.stage, s.bird, bird) for bird, s in stages] == [
            (tick, bird, bird) for tick in ticks for bird in range(1, len(self.birds) + 1)
        ]

    # --- what an adversary may do ---

    def deliverable(self, to: str | None = None) -> list[Queue]:
        """The queues from which their receivers would take something now."""
        return [
            queue
            for queue in self.queues.values()
            if queue.messages and (to is None or queue.to.who == to) and self._takes(queue)
        ]

    def _takes(self, queue: Queue) -> bool:
        receiver = queue.to.core
        if queue.to.who == RECORDER:
            # It leaves everything but grants where it is until it has joined the epoch.
            return queue.topic == topics.GRANT_TOPIC or bool(receiver.joined)
        # What a bird keeps is bounded, and relies on order: without, it has to look later.
        return self.ordered or not queue.topic.endswith("/stage") or receiver.in_flight

    def deliver(self, queue: Queue, *, copy: bool = False) -> None:
        """Deliver the next message of a queue (any one where there is no order), or a copy."""
        at = 0 if self.ordered else self.random.randrange(len(queue.messages))
        data = queue.messages[at] if copy else queue.messages.pop(at)
        queue.to.hears[queue.topic](data)
        self._look_around()

    def deliver_some(self, count: int, to: str | None = None) -> None:
        for _ in range(count):
            queues = self.deliverable(to)
            if not queues:
                return
            self.deliver(self.random.choice(queues), copy=self.random.random() < 0.1)

    def stop(self) -> None:
        self._say(self.keeper.stop())
        self.stopped_at = self.keeper.end
        self._look_around()

    def take_a_step(self) -> None:
        self._say(self.keeper.take_steps(1))

    def resume(self) -> None:
        self._say(self.keeper.resume())

    def flush(self) -> None:
        if RECORDER in self.living:
            self.living[RECORDER].core.keep_safe()

    def report(self) -> None:
        """Let everybody say again where they are, as they do every second."""
        for who, process in list(self.living.items()):
            if who == CLOCK:
                if not self.over:
                    self._say([process.core.grant])
            elif who == RECORDER:
                process.core.report()
        for process in self._live_birds():
            self._send(process, process.core.report())

    def _look_around(self) -> None:
        if RECORDER in self.living:
            self.living[RECORDER].core.join()
        if CLOCK in self.living and self.keeper.finished and not self.over:
            self.over = True
            self._say([self.keeper.release])

    # --- the end ---

    def settle(self) -> None:
        """Let everybody live and hear everything; then the flight is what it should be."""
        if not self.over:
            self.bring(*self.random.sample(self.dead, k=len(self.dead)))
            self.resume()
        quiet = 0
        seen = self._position()
        while quiet < QUIET_ROUNDS:
            while queues := self.deliverable():
                self.deliver(self.random.choice(queues))
            self.flush()
            if self.deliverable():
                continue
            if self.over:
                break
            self.report()
            quiet = quiet + 1 if self._position() == seen else 0
            seen = self._position()
        assert self.over, self.why_it_stands_still()
        self._check_the_end()

    def _position(self) -> object:
        return (
            self.over,
            self.disk.saved,
            [(p.who, p.core.step, p.core.in_flight, p.core._epoch) for p in self._live_birds()],
            (self.keeper.epoch, self.keeper.step) if CLOCK in self.living else None,
        )

    def _live_birds(self) -> list[Process]:
        return [*(self.living[who] for who in self.birds if who in self.living), *self.twins]

    def why_it_stands_still(self) -> str:
        keeper = self.keeper
        lines = [
            f"the clock, {keeper.where}, epoch {keeper.epoch}, granted {keeper.grant.step}, waits "
            f"for {keeper.waiting_for}; on disk: {self.disk.saved}"
        ]
        lines += [f"{p.who} waits for {p.core.waiting_for}" for p in self._live_birds()]
        return "\n".join(lines)

    def _check_the_end(self) -> None:
        end = self.keeper.end
        if self.stopped_at is None:
            assert end == self.configuration.steps
        every = self.configuration.record_every
        due = list(range(0, end + 1, every))
        if self.record:
            assert [row.step for row in self.disk.rows] == due
            wings = [Wing.decode(data) for data in self.disk.rows[0].wings]
            ratios = self.configuration.span_ratio
            assert [wing.span_ratio.tolist() for wing in wings] == ratios.tolist()
        else:
            sent = {(who, step) for who, step in self._sent if step <= end}
            assert sent == {(who, step) for who in self.birds for step in due}
        for process in self._live_birds():
            assert process.core.released
            assert process.core.finished
        if RECORDER in self.living:
            assert self.living[RECORDER].core.released
            assert self.living[RECORDER].core.ledger.complete
