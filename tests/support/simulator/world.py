# SPDX-License-Identifier: Apache-2.0
"""A simulated flock whose birds, clock and recorder a test kills and restarts.

Topics are reliable and latched as in ROS 2, with additional faults: every message in flight may be
delayed, reordered and duplicated, and a stage may be lost. A publisher keeps the last messages of
each topic for late joiners, until it ends. If it is killed, its messages in flight are delivered or
lost. A full queue loses its oldest message.

`World` checks the invariants at every moment. `settle` ends all faults, delivers all messages to
live processes, and checks the result and the number of deliveries.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Iterable
from dataclasses import replace
from random import Random
from typing import Any

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.errors import FlockError
from flock_sim.launcher.supervisor import MOST_DEATHS
from flock_sim.messages import topics
from flock_sim.messages.epochs import REACH, ahead
from flock_sim.messages.topics import RECORDER, bird_name
from flock_sim.messages.types import (
    Checkpoint,
    Grant,
    Progress,
    Push,
    Stage,
    State,
    Time,
    Wing,
)
from flock_sim.nodes.recorder_protocol import RecorderProtocol
from flock_sim.physics.arrays import FloatArray
from flock_sim.physics.runge_kutta import STAGES
from flock_sim.protocol.bird import BirdProtocol
from flock_sim.protocol.clock import Timekeeper
from flock_sim.protocol.session import Channel, Outgoing
from flock_sim.recording.row_assembler import Row
from support.network import expected_states
from support.simulator.liveness import most_deliveries, most_epochs
from support.simulator.recorder import RUN, Disk, SimulatedRecording
from support.simulator.wires import Process, Queue, Wires

CLOCK = "clock"
FORGER = "forger"
STUCK_ROUNDS = 2
"""Rounds of reports without progress of the flock after which the clock rewinds it, once a step."""
QUIET_ROUNDS = 4
"""Rounds of reports without progress of the flock after which it counts as stuck."""


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
        self._topics = {
            bird_name(bird): {
                Channel.WING: topics.wing_topic(bird),
                Channel.STAGE: topics.stage_topic(bird),
                Channel.STATE: topics.state_topic(bird),
                Channel.MEMORY: topics.memory_topic(bird),
                Channel.PROGRESS: topics.PROGRESS_TOPIC,
            }
            for bird in range(1, configuration.birds + 1)
        }
        self.everybody = [*self.birds, CLOCK, *([RECORDER] if record else [])]
        self.living: dict[str, Process] = {}
        self.twins: list[Process] = []
        """Live processes that have been replaced by a new incarnation."""
        self.forgers: list[Process] = []
        """Processes whose latched messages are forged."""
        self.wires = Wires(random)
        self.disk = Disk(self._check_row)
        self.over = False
        """Whether the clock has released all processes: it then ignores messages."""
        self.forged = 0
        """Number of forged messages, those without listeners included."""
        self.genuine: dict[str, bytes] = {}
        """The last message of each topic that was not forged."""
        self.stopped_at: int | None = None
        self.deaths = self.twins_started = 0
        self.ticks = 0
        """Runge-Kutta stages that birds have computed. Four of a bird are one step of it."""
        self.most_epochs = self.bound = self.needed = 0
        """The most epochs and deliveries that `settle` may need, and the deliveries it needed."""
        self._incarnations = 0
        self._listeners: dict[str, list[Process]] = {}  # by topic, until a process comes or goes
        self._depths: dict[str, int] = {}
        self._stuck = -1  # the step at which the clock found the flock stuck before
        self._granted: dict[int, int] = {}  # the furthest granted step of each epoch
        self._asked: list[int] = []  # numbers of pushes that must be flown unless a process dies
        self._pushes: dict[int, tuple[str, ...]] = {}  # those flown in each epoch, as text
        self._expected: dict[tuple[str, ...], dict[str, list[bytes]]] = {}
        self._sent: set[tuple[str, int]] = set()  # (bird, step) of every state

    # --- life and death ---

    @property
    def dead(self) -> list[str]:
        return [who for who in self.everybody if who not in self.living]

    @property
    def processes(self) -> list[Process]:
        """All live processes, forgers excepted."""
        return [*self.living.values(), *self.twins]

    @property
    def bird_processes(self) -> list[Process]:
        return [*(self.living[who] for who in self.birds if who in self.living), *self.twins]

    @property
    def forged_effects(self) -> int:
        """The most epochs that may begin because of forged messages, sent or in flight."""
        return 2 * (len(self.processes) + 1) if self.forged else 0

    @property
    def epochs(self) -> int:
        """Number of epochs that clocks have begun."""
        return len(self._granted)

    @property
    def may_stand_still(self) -> bool:
        """Whether it may take a rewind by the clock's watchdog to go on.

        A forged grant can part birds. A twin ignores stages that are too far ahead, while others
        fly with its faster twin; when that dies, it lacks them. A lost stage is repeated only until
        its sender is two stages ahead, which is too short for the recorder.
        """
        return bool(self.forged or self.twins_started or (self.stages and self.wires.lost))

    @property
    def keeper(self) -> Timekeeper:
        return self.living[CLOCK].core

    def bird(self, number: int) -> BirdProtocol:
        return self.living[bird_name(number)].core

    def bring(self, *names: str) -> None:
        """Start a process for each name, also beside a live one. Queue latched messages."""
        for who in names:
            make = {CLOCK: self._clock, RECORDER: self._recorder}.get(who, self._bird)
            if who in self.living:
                self.twins_started += 1
                self.twins.append(self.living[who])
            newcomer = self.living[who] = make(who, self.new_life())
            self._listeners.clear()
            self.wires.note("begins", who, newcomer.life)
            for other in [*self.processes, *self.forgers]:
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
            self._cut(self.living.pop(who))
            if who in (CLOCK, RECORDER):
                self._asked = [number for number in self._asked if number in self.disk.live]

    def kill_twin(self, twin: Process) -> None:
        """Kill one of `twins`."""
        self.twins.remove(twin)
        self._cut(twin)

    def _cut(self, gone: Process) -> None:
        self._listeners.clear()
        self.wires.note("dies", gone.life)
        self.wires.cut(gone)
        self.deaths += 1

    def new_life(self) -> int:
        """Return the incarnation of a new process."""
        self._incarnations += 1000
        return self._incarnations

    def let_end(self) -> list[str]:
        """End the processes that have nothing left to do; return their names, twins excepted."""
        ended = [p for p in self.processes if p.who != CLOCK and self._has_ended(p)]
        for process in ended:
            self._listeners.clear()
            self.wires.note("ends", process.life)
            self.wires.drop([queue for queue in self.wires.queues if queue.to is process])
            if process in self.twins:
                self.twins.remove(process)
            else:
                del self.living[process.who]
        return [process.who for process in ended if process.who not in self.living]

    @staticmethod
    def _has_ended(process: Process) -> bool:
        return bool(process.core.finished and (process.who == RECORDER or process.core.released))

    def _bird(self, who: str, life: int) -> Process:
        number = self.birds.index(who) + 1
        known = RUN if self.random.random() < 0.5 else 0
        bird = BirdProtocol(number, self.configuration, known, life)
        self._count_ticks(bird)
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

    def _count_ticks(self, bird: BirdProtocol) -> None:
        motion = bird._motion
        compute = motion.compute

        def counted(tick: int, heard: FloatArray) -> None:
            self.ticks += 1
            compute(tick, heard)

        motion.compute = counted

    def _clock(self, who: str, life: int) -> Process:
        epoch = self.random.randint(1, REACH)
        keeper = Timekeeper(self.configuration, RUN, self.window, self.record, self.stages, epoch)
        self._stuck = -1

        def hear(data: bytes) -> None:
            if not self.over:
                self._say(keeper.receive(Progress.decode(data)))

        return Process(who, life, keeper, {topics.PROGRESS_TOPIC: hear})

    def _recorder(self, who: str, life: int) -> Process:
        recording: Any = SimulatedRecording(self.disk)
        recorder = RecorderProtocol(self.configuration, recording, RUN, life, self.stages)
        assembler = recorder.assembler
        process = Process(who, life, recorder)

        def hears(add: Callable[..., list[Row]], *what: int) -> Callable[[bytes], None]:
            return lambda data: recorder.write(add(*what, data))

        process.hears = {
            topics.GRANT_TOPIC: lambda data: self._report(process, recorder.receive_grant(data)),
            topics.PERTURBATION_TOPIC: recorder.receive_push,
            topics.CLOCK_TOPIC: hears(assembler.add_time),
        }
        for bird in range(1, self.configuration.birds + 1):
            process.hears[topics.wing_topic(bird)] = hears(recorder.receive_wing, bird)
            process.hears[topics.state_topic(bird)] = hears(assembler.add_state, bird)
            process.hears[topics.memory_topic(bird)] = hears(assembler.add_memory, bird)
            if self.stages:
                process.hears[topics.stage_topic(bird)] = hears(assembler.add_stage, bird)
        return process

    # --- messages ---

    def post_forged(self, topic: str, data: bytes, *to: str, latched: bool = False) -> None:
        """Send a message of a forger `to` processes, or to some listeners of the topic.

        If it is `latched`, late joiners get it, too.
        """
        self.forged += 1
        forger = Process(FORGER, self.new_life(), None)
        if latched:
            forger.latched[topic] = deque([data])
            self.forgers.append(forger)
        listeners = self.listeners(topic)
        some = self.random.sample(listeners, k=self.random.randint(0, len(listeners)))
        for listener in [self.living[who] for who in to] or some:
            self._post(forger, listener, topic, data)

    def _publish(self, sender: Process, topic: str, data: bytes) -> None:
        self.genuine[topic] = data
        depth = self._depth(topic)
        sender.latched.setdefault(topic, deque(maxlen=depth)).append(data)
        for listener in self.listeners(topic):
            self._post(sender, listener, topic, data)

    def listeners(self, topic: str) -> list[Process]:
        """The live processes that subscribe to a topic."""
        if topic not in self._listeners:
            self._listeners[topic] = [p for p in self.processes if topic in p.hears]
        return self._listeners[topic]

    def _depth(self, topic: str) -> int:
        if topic not in self._depths:
            self._depths[topic] = topics.depth(topic, self.configuration)
        return self._depths[topic]

    def _post(self, sender: Process, to: Process, topic: str, data: bytes) -> None:
        lost = self.wires.post(sender, to, topic, data, self._depth(topic))
        if lost and topic.endswith("/state") and State.envelope(lost) >= State.envelope(data):
            # Only a forged grant lets birds fly so far ahead of the disk.
            assert self.forged or State.step_of(lost) <= self.disk.saved, "a queue lost a state"

    def _send(self, process: Process, out: list[Outgoing]) -> None:
        for channel, data in out:
            if channel is Channel.STATE:
                step = State.step_of(data)
                pushes = self._pushes.get(State.envelope(data)[1], ())
                assert State.opened(data) == self._state(process.who, step, pushes), (
                    f"{process.who} has other bits at step {step} than the reference"
                )
                granted = self._granted.get(State.envelope(data)[1], 0)
                assert self.forged or step <= granted, "a state beyond what was granted"
                self._sent.add((process.who, step))
            self._publish(process, self._topics[process.who][channel], data)

    def _state(self, who: str, step: int, pushes: tuple[str, ...]) -> bytes:
        """Return the state of a bird of the reference flight with `pushes`, as in a bag."""
        if pushes not in self._expected:
            configuration = self.configuration
            pushed = (*configuration.perturbations, *pushes)
            states = expected_states(replace(configuration, perturbations=pushed))
            self._expected[pushes] = {bird_name(bird): rows for bird, rows in states.items()}
        return self._expected[pushes][who][step // self.configuration.record_every]

    @property
    def _pushes_on_disk(self) -> tuple[str, ...]:
        return tuple(map(str, self.disk.live.values()))

    def _report(self, recorder: Process, out: Iterable[Progress | Checkpoint]) -> None:
        for message in out:
            topic = topics.PROGRESS_TOPIC
            if isinstance(message, Checkpoint):
                topic = topics.CHECKPOINT_TOPIC
                self._pushes[message.epoch] = self._pushes_on_disk
            self._publish(recorder, topic, message.encode())

    def _say(self, messages: Iterable[Any]) -> None:
        for message in messages:
            if isinstance(message, Grant):
                self._check_leave(message)
                before = self._granted.get(message.epoch, 0)
                self._granted[message.epoch] = max(before, message.step)
            topic = {
                Grant: topics.GRANT_TOPIC,
                Time: topics.CLOCK_TOPIC,
                Checkpoint: topics.CHECKPOINT_TOPIC,
                Push: topics.PERTURBATION_TOPIC,
            }[type(message)]
            self._publish(self.living[CLOCK], topic, message.encode())

    def _check_leave(self, grant: Grant) -> None:
        if self.record and grant.step <= grant.end:
            ahead = topics.steps_ahead(self.configuration, self.stages)
            assert grant.step <= max(self.disk.saved, 0) + ahead, "more leave than queues can hold"

    def _check_row(self, row: Row) -> None:
        """Check a row that is about to be put on disk."""
        due = 0 if self.disk.saved < 0 else self.disk.saved + self.configuration.record_every
        assert row.step == due, "rows once each, in order"
        pushes = self._pushes_on_disk
        assert row.states == [self._state(who, row.step, pushes) for who in self.birds]
        assert Time.decode(row.time).stamp == self.configuration.stamp(row.step)
        if self.stages:
            self._check_stages(row)

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
            for queue in self.wires.queues
            if (to is None or queue.to.who == to) and self._takes(queue)
        ]

    def _choose(self, to: str | None = None) -> Queue | None:
        if to is None:
            return self.wires.choose(self._takes)
        return self.wires.choose(lambda queue: queue.to.who == to and self._takes(queue))

    def _takes(self, queue: Queue) -> bool:
        receiver = queue.to.core
        if queue.to.who == RECORDER:
            # The recorder takes only grants and pushes until it has joined the epoch.
            early = (topics.GRANT_TOPIC, topics.PERTURBATION_TOPIC)
            return queue.topic in early or bool(receiver.joined)
        # A bird's inbox is bounded and relies on order. Without order, stages are taken later.
        return self.wires.ordered or not queue.topic.endswith("/stage") or receiver.in_flight

    def deliver(self, queue: Queue, *, copy: bool = False) -> None:
        """Deliver a message of a queue, or a copy of it."""
        self.wires.deliver(queue, copy=copy)
        if queue.to.who in (CLOCK, RECORDER):
            self._look_around()

    def deliver_some(self, count: int, to: str | None = None) -> bool:
        """Deliver so many messages, if there are as many; return whether there were."""
        for _ in range(count):
            queue = self._choose(to)
            if queue is None:
                return False
            again = queue.sender.who != FORGER and self.random.random() < 0.1
            self.deliver(queue, copy=again)
        return True

    def stop(self) -> None:
        self._say(self.keeper.stop())
        self.stopped_at = self.keeper.end
        self._look_around()

    def take_a_step(self) -> None:
        self._say(self.keeper.take_steps(1))

    def resume(self) -> None:
        self._say(self.keeper.resume())

    def rewind(self) -> None:
        """Let the clock rewind a flock that has not moved for a while, as `keep_time` does."""
        if self.keeper.begun:
            self._say(self.keeper.rewind())

    def push(self, bird: int, member: int, position: float, speed: float) -> bool:
        """Request a push in flight at the soonest possible step; return whether it is accepted."""
        try:
            _, messages = self.keeper.perturb(bird, member, 0, position, speed)
        except FlockError:
            return False
        # A forged push with the number of a genuine one can't be told from it.
        self.wires.drop(
            queue
            for queue in self.wires.queues
            if queue.topic == topics.PERTURBATION_TOPIC and queue.sender.who == FORGER
        )
        self._asked.append(messages[0].number)
        self._say(messages)
        return True

    def flush(self) -> None:
        recorder = self.living.get(RECORDER)
        if recorder and recorder.core.unsaved:
            self._report(recorder, recorder.core.save())

    def report(self) -> None:
        """Let all processes repeat their reports, as they do every second."""
        for who, process in list(self.living.items()):
            if who == CLOCK:
                if not self.over:
                    self._say(process.core.repeated)
                elif process.core.stopped:
                    self._say([process.core.release])
            elif who == RECORDER:
                self._report(process, process.core.report())
        for process in self.bird_processes:
            self._send(process, process.core.report())

    def _look_around(self) -> None:
        recorder = self.living.get(RECORDER)
        if recorder and recorder.core.may_join:
            complete = recorder.core.assembler.complete
            if complete or all(who in self.living for who in self.birds):
                self._report(recorder, recorder.core.join())
        if CLOCK in self.living and self.keeper.finished and not self.over:
            self.over = True
            self.wires.drop([q for q in self.wires.queues if q.sender.who == FORGER])
            self._say([self.keeper.release])

    # --- the end ---

    def settle(self) -> None:
        """End all faults and deliver all messages. Then check the flight."""
        self.forgers.clear()
        if not self.over:
            self.bring(*self.random.sample(self.dead, k=len(self.dead)))
            self.resume()
        self.most_epochs = most_epochs(self)
        self.bound = most_deliveries(self, self.most_epochs)
        before, epochs = self.wires.deliveries, self.epochs
        restarts: Counter[str] = Counter()
        quiet, farewell = 0, False
        seen = self._position()
        while quiet < QUIET_ROUNDS:
            while queue := self._choose():
                self.deliver(queue)
            self.flush()
            if self.deliverable():
                continue
            if farewell:
                break
            farewell = self.over
            self._supervise(restarts)
            self.report()
            quiet = quiet + 1 if self._position() == seen else 0
            seen = self._position()
            if quiet == STUCK_ROUNDS and self.may_stand_still:
                self._rewind_if_stuck()
        assert self.over, self.why_it_stands_still()
        self.needed = self.wires.deliveries - before
        begun = self.epochs - epochs
        assert begun <= self.most_epochs, f"{begun} epochs, more than {self.most_epochs}"
        assert self.needed <= self.bound, f"{self.needed} deliveries, more than {self.bound}"
        self._check_the_end()

    def _rewind_if_stuck(self) -> None:
        """Rewind the flock as the watchdog of the clock does: once at each step."""
        if not self.over and self.keeper.step > self._stuck:
            self._stuck = self.keeper.step
            self.rewind()

    def _supervise(self, restarts: Counter[str]) -> None:
        """Restart the processes that have ended before the flight is over."""
        if not self.over and (ended := self.let_end()):
            restarts.update(ended)
            assert max(restarts.values()) <= MOST_DEATHS, f"{restarts} ends without any progress"
            self.bring(*ended)

    def _position(self) -> object:
        return (
            self.over,
            self.disk.saved,
            [
                (p.who, p.core.step, p.core.in_flight, p.core._session.epoch)
                for p in self.bird_processes
            ],
            (self.keeper.epoch, self.keeper.step) if CLOCK in self.living else None,
        )

    def why_it_stands_still(self) -> str:
        keeper = self.keeper
        lines = [
            f"the clock, {keeper.where}, epoch {keeper.epoch}, granted {keeper.grant.step}, waits "
            f"for {keeper.waiting_for}; on disk: {self.disk.saved}"
        ]
        waiting = [*self.bird_processes, *([self.living[RECORDER]] if self.record else [])]
        lines += [
            f"{p.who}, in epoch {p.core._session.epoch}, waits for {p.core.waiting_for}"
            for p in waiting
        ]
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
            assert set(self._asked) <= set(self.disk.live), "a push was accepted and not flown"
        else:
            sent = {(who, step) for who, step in self._sent if step <= end}
            assert sent == {(who, step) for who in self.birds for step in due}
        if self.forged:
            return  # a grant forged at the end may hide the release, the last message of the clock
        for process in self.bird_processes:
            # A short flight may end before its clock hears a twin in a later epoch of another one.
            if process in self.twins and ahead(process.core._session.epoch, self.keeper.epoch) > 0:
                continue
            assert process.core.released
            assert process.core.finished
        if RECORDER in self.living:
            assert self.living[RECORDER].core.finished
