# SPDX-License-Identifier: Apache-2.0
"""A simulated flock whose birds, clock and recorder a test kills and restarts.

Topics are reliable and latched as in ROS 2, with additional faults: every message in flight may be
delayed, reordered and duplicated. A publisher keeps the last messages of each topic for late
joiners, until it dies. Its messages in flight are then delivered or lost. A full queue loses its
oldest message.

`World` checks the invariants at every moment. `settle` delivers all messages to live processes and
checks the result.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from random import Random
from typing import Any

import numpy as np

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.messages import topics
from flock_sim.messages.epochs import EPOCHS, NEVER, REACH, out_of_date
from flock_sim.messages.topics import RECORDER, bird_name
from flock_sim.messages.types import (
    Checkpoint,
    Grant,
    Memory,
    Progress,
    Stage,
    State,
    Time,
    Wing,
)
from flock_sim.physics.runge_kutta import STAGES
from flock_sim.protocol.bird import BirdProtocol
from flock_sim.protocol.clock import Timekeeper
from flock_sim.protocol.session import Channel, Outgoing, Session
from flock_sim.recording.row_assembler import Row, RowAssembler
from support.network import expected_states

RUN = 7
CLOCK = "clock"
FORGER = "forger"
FAR = (1, 2, 1000, REACH, 2**30, 2**31 - 1, 2**31, 2**32 - REACH, 2**32 - 1000)
"""Distances of forged epochs from those of the flight."""
QUIET_ROUNDS = 4
"""Rounds of reports without progress of the flock after which it counts as stuck."""


@dataclass(eq=False)
class Queue:
    """The messages in flight from one process to another on one topic."""

    sender: Process
    to: Process
    topic: str
    messages: list[bytes] = field(default_factory=list)


@dataclass(eq=False)
class Process:
    """One incarnation of a bird, the clock or the recorder."""

    who: str
    life: int
    core: Any
    hears: dict[str, Callable[[bytes], None]] = field(default_factory=dict)
    latched: dict[str, deque[bytes]] = field(default_factory=dict)


class Disk:
    """The recorder's data on disk, which survive its death."""

    def __init__(self) -> None:
        self.rows: list[Row] = []
        self.epoch = NEVER  # the last epoch with a grant on disk

    @property
    def saved(self) -> int:
        return self.rows[-1].step if self.rows else -1


class Recorder:
    """The recorder without ROS and bag: a RowAssembler, and a disk that is flushed at times."""

    def __init__(self, world: World, life: int) -> None:
        self.assembler = RowAssembler(world.configuration, world.stages, world.disk.saved)
        self.joined = False
        self.released = False
        self._world = world
        self._session = Session("the recorder", world.configuration, RUN, life)
        self._written: list[Row] = []

    @property
    def _epoch(self) -> int:
        return self._session.epoch

    def hear_grant(self, grant: Grant) -> None:
        disk = self._world.disk
        if self._session.refuses_grant(grant):
            return
        if self._epoch == NEVER and out_of_date(grant.epoch, disk.epoch):
            self._say_saved(disk.epoch)
            return
        if self._session.take_grant(grant):
            self._flush()
            if not self.assembler.complete:
                disk.epoch = grant.epoch
            self.assembler.begin(RUN, grant.epoch)
            self.joined = self.released = False
        self.released |= grant.step > grant.end
        self.assembler.end_at(grant.end)

    def join(self) -> None:
        """Publish the checkpoint of the epoch once the topics of all birds are found."""
        if self._epoch == NEVER or self.joined:
            return
        if self.assembler.complete or self._world.all_birds_live:
            self.joined = self._session.flying = True
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
            self._say_saved(self._epoch)

    def _say_saved(self, epoch: int) -> None:
        saved = Progress(RUN, self._world.disk.saved, epoch, RECORDER, self._session.incarnation)
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
            forcing_state=np.concatenate([state.forcing_state for state in states]),
            memory=np.concatenate(
                [np.empty(0), *(Memory.decode(data).data for data in disk.rows[-1].memories)]
            ),
        )


class World:
    """A flock with its clock and recorder. It is empty until `bring` starts processes."""

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
        """Live processes that have been replaced by a new incarnation."""
        self.queues: dict[tuple[int, int, str], Queue] = {}
        self.disk = Disk()
        self.over = False
        """Whether the clock has released all processes: it then ignores messages."""
        self.ordered = random.random() < 0.7
        """Whether the messages of one publisher on one topic keep their order, as in DDS."""
        self.forged = False
        """Whether messages have been forged."""
        self.stopped_at: int | None = None
        self.deaths = 0
        self._incarnations = 0
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
        """Start a process for each name, also beside a live one. Queue latched messages."""
        for who in names:
            self._incarnations += 1000
            make = {CLOCK: self._clock, RECORDER: self._recorder}.get(who, self._bird)
            if who in self.living:
                self.twins.append(self.living[who])
            newcomer = self.living[who] = make(who, self._incarnations)
            for other in [*self.living.values(), *self.twins]:
                if other is not newcomer:
                    for topic in (name for name in newcomer.hears if name in other.latched):
                        for data in other.latched[topic]:
                            self._post(other, newcomer, topic, data)
            if who == CLOCK:
                self._say(newcomer.core.first_messages)
        self._look_around()

    def kill(self, *names: str) -> None:
        """Kill processes. Their messages in flight are delivered or lost."""
        for who in names:
            gone = self.living.pop(who)
            self.deaths += 1
            for key, queue in list(self.queues.items()):
                if queue.to is gone:
                    del self.queues[key]
                elif queue.sender is gone:
                    # A random number of the first messages in flight is kept.
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
        epoch = self.random.randint(1, REACH)
        keeper = Timekeeper(self.configuration, RUN, self.window, self.record, self.stages, epoch)

        def hear(data: bytes) -> None:
            if not self.over:
                self._say(keeper.receive(Progress.decode(data)))

        return Process(who, life, keeper, {topics.PROGRESS_TOPIC: hear})

    def _recorder(self, who: str, life: int) -> Process:
        recorder = Recorder(self, life)
        assembler = recorder.assembler

        def hears(add: Callable[..., list[Row]], *what: int) -> Callable[[bytes], None]:
            return lambda data: recorder.write(add(*what, data))

        process = Process(who, life, recorder)
        process.hears = {
            topics.GRANT_TOPIC: lambda data: recorder.hear_grant(Grant.decode(data)),
            topics.CLOCK_TOPIC: hears(assembler.add_time),
        }
        for bird in range(1, self.configuration.birds + 1):
            process.hears[topics.wing_topic(bird)] = hears(assembler.add_wing, bird)
            process.hears[topics.state_topic(bird)] = hears(assembler.add_state, bird)
            process.hears[topics.memory_topic(bird)] = hears(assembler.add_memory, bird)
            if self.stages:
                process.hears[topics.stage_topic(bird)] = hears(assembler.add_stage, bird)
        return process

    # --- messages ---

    def publish(self, who: str, topic: str, data: bytes) -> None:
        """Send a message to all current listeners, and keep it for late joiners."""
        self._publish(self.living[who], topic, data)

    def _publish(self, sender: Process, topic: str, data: bytes) -> None:
        depth = topics.depth(topic, self.configuration)
        sender.latched.setdefault(topic, deque(maxlen=depth)).append(data)
        for listener in [*self.living.values(), *self.twins]:
            if topic in listener.hears:
                self._post(sender, listener, topic, data)

    def _post(self, sender: Process, to: Process, topic: str, data: bytes) -> None:
        """Queue a message. A full queue may lose its oldest message."""
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
        due = self.configuration.link_table.exchange_schedule.due
        every = [STAGES * step + stage for step in steps for stage in range(STAGES)]
        ticks = [tick for tick in every if due(tick)]
        stages = [(bird, Stage.decode(data)) for bird, data in row.stages]
        assert [(STAGES * s.step + s.stage, s.bird, bird) for bird, s in stages] == [
            (tick, bird, bird) for tick in ticks for bird in range(1, len(self.birds) + 1)
        ]

    # --- actions of an adversary ---

    def deliverable(self, to: str | None = None) -> list[Queue]:
        """The queues from which their receivers would take a message now."""
        return [
            queue
            for queue in self.queues.values()
            if queue.messages and (to is None or queue.to.who == to) and self._takes(queue)
        ]

    def _takes(self, queue: Queue) -> bool:
        receiver = queue.to.core
        if queue.to.who == RECORDER:
            # The recorder takes only grants until it has joined the epoch.
            return queue.topic == topics.GRANT_TOPIC or bool(receiver.joined)
        # A bird's inbox is bounded and relies on order. Without order, stages are taken later.
        return self.ordered or not queue.topic.endswith("/stage") or receiver.in_flight

    def deliver(self, queue: Queue, *, copy: bool = False) -> None:
        """Deliver the next message of a queue (any message if not `ordered`), or a copy."""
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

    def forge(self) -> None:
        """Send some listeners a message with an epoch that no process of the flight has begun."""
        self.forged = True
        known = [process.core._session.epoch for process in self._live_birds()]
        known += [self.keeper.epoch] if CLOCK in self.living else []
        epoch = self.random.choice([epoch for epoch in known if epoch != NEVER] or [1])
        epoch = (epoch + self.random.choice(FAR) + self.random.randint(-1, 1)) % EPOCHS or 1
        grant = Timekeeper(self.configuration, RUN, 1, False, epoch=epoch).grant
        who = self.random.choice(self.birds)
        topic, message = self.random.choice(
            [
                (topics.GRANT_TOPIC, grant),
                (topics.PROGRESS_TOPIC, Progress(RUN, -1, epoch, who, 1)),
            ]
        )
        listeners = [p for p in [*self.living.values(), *self.twins] if topic in p.hears]
        self._incarnations += 1
        forger = Process(FORGER, self._incarnations, None)
        for listener in self.random.sample(listeners, k=self.random.randint(0, len(listeners))):
            self._post(forger, listener, topic, message.encode())

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
        """Let all processes repeat their reports, as they do every second."""
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
            self.queues = {k: q for k, q in self.queues.items() if q.sender.who != FORGER}
            self._say([self.keeper.release])

    # --- the end ---

    def settle(self) -> None:
        """Start all dead processes and deliver all messages. Then check the flight."""
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
            if self.over and quiet:
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
            [
                (p.who, p.core.step, p.core.in_flight, p.core._session.epoch)
                for p in self._live_birds()
            ],
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
        if self.forged:
            return  # a grant forged at the end may hide the release, the last message of the clock
        for process in self._live_birds():
            assert process.core.released
            assert process.core.finished
        if RECORDER in self.living:
            assert self.living[RECORDER].core.released
            assert self.living[RECORDER].core.assembler.complete
