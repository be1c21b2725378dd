# SPDX-License-Identifier: Apache-2.0
"""The topics of the nodes: their names, their quality of service, and their receivers."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np
import pytest
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, ReliabilityPolicy

from flock_interfaces.msg import Progress
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.messages import topics
from flock_sim.messages import types as messages
from flock_sim.messages.handshake import handshake
from flock_sim.messages.rejection import FOREIGN
from flock_sim.nodes import row_topics
from flock_sim.nodes.announcements import Announcements
from flock_sim.nodes.bird import BirdNode
from flock_sim.nodes.clock import ClockNode
from flock_sim.nodes.recorder import RecorderNode
from flock_sim.nodes.row_topics import LOOK_EVERY, Source
from flock_sim.protocol.attendance import ABSENT
from flock_sim.protocol.clock import Timekeeper
from flock_sim.recording.flight_writer import recording
from flock_sim.ros.endpoints import DrainedNode, latched

CONFIGURATION = FlockConfiguration(birds=3, t_max=10.0)
BIRDS = ("bird_01", "bird_02", "bird_03")


@contextmanager
def flock(context: Context, directory: Path) -> Iterator[dict[str, Node]]:
    """All nodes of a flock of three, none of them spun."""
    with ExitStack() as stack:
        run = stack.enter_context(recording(directory / "bag", CONFIGURATION, grants=True))
        keeper = Timekeeper(CONFIGURATION, 7, 4, True)
        nodes: dict[str, Node] = {
            "clock": ClockNode(keeper, 64, context=context),
            "recorder": RecorderNode(CONFIGURATION, run, 0, False, context=context),
            **{
                name: BirdNode(i, CONFIGURATION, context=context) for i, name in enumerate(BIRDS, 1)
            },
        }
        for node in nodes.values():
            stack.callback(node.destroy_node)
        for name in BIRDS:
            Announcements([nodes[name]])
        yield nodes


def until(condition: Callable[[], object]) -> None:
    deadline = time.monotonic() + 30.0
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def test_every_topic_has_who_should_send_and_hear_it(context: Context, tmp_path: Path) -> None:
    neighbours = {"bird_01": {"bird_02"}, "bird_02": {"bird_01", "bird_03"}, "bird_03": {"bird_02"}}
    expected = {
        "/clock": ({"clock"}, {"recorder"}),
        "/flock/clock/grant": ({"clock"}, {"clock", "recorder", *BIRDS}),
        "/flock/checkpoint": ({"clock", "recorder"}, set(BIRDS)),
        "/flock/progress": ({"recorder", *BIRDS}, {"clock"}),
        "/flock/perturbation": ({"clock"}, {"recorder"}),
    }
    for bird in BIRDS:
        expected |= {
            f"/flock/{bird}/wing": ({bird}, {"recorder"} | neighbours[bird]),
            f"/flock/{bird}/stage": ({bird}, neighbours[bird]),
            f"/flock/{bird}/state": ({bird}, {"recorder"}),
        }
    with flock(context, tmp_path) as nodes:
        clock = nodes["clock"]

        def found() -> dict[str, tuple[set[str], set[str]]]:
            return {
                topic: (
                    {end.node_name for end in clock.get_publishers_info_by_topic(topic)},
                    {end.node_name for end in clock.get_subscriptions_info_by_topic(topic)},
                )
                for topic in expected
            }

        until(lambda: found() == expected)
        for topic in expected:
            publishers = clock.get_publishers_info_by_topic(topic)
            for end in [*publishers, *clock.get_subscriptions_info_by_topic(topic)]:
                assert end.node_namespace == "/flock"
                assert end.qos_profile.reliability == ReliabilityPolicy.RELIABLE
                assert end.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL


def test_everything_is_reliable_and_latched_to_a_depth() -> None:
    profile = latched(17)
    assert profile.reliability == ReliabilityPolicy.RELIABLE
    assert profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
    assert (profile.history, profile.depth) == (HistoryPolicy.KEEP_LAST, 17)


def test_a_drained_subscription_is_hidden_from_executors_and_taken_by_hand(
    context: Context,
) -> None:
    served: list[Progress] = []
    node = DrainedNode("listener", context=context)
    sender = Node("sender", context=context)
    inlet = node.subscribe_drained(Progress, "drained")
    node.create_subscription(Progress, "served", served.append, latched(10))
    assert [s.topic_name for s in node.subscriptions] == ["/served"]

    outlets = [
        sender.create_publisher(Progress, name, latched(10)) for name in ("drained", "served")
    ]
    for step in range(3):
        for outlet in outlets:
            outlet.publish(Progress(step=step, who="sender"))
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    until(lambda: executor.spin_once(timeout_sec=0.05) or len(served) == 3)
    taken: list[bytes] = []

    def take() -> bool:
        data = inlet.take()
        if data is not None:
            taken.append(data)
        return len(taken) == 3

    until(take)
    assert inlet.take() is None
    assert [m.step for m in served] == [0, 1, 2]
    assert [data[:4] for data in taken] == [b"\0\1\0\0"] * 3
    executor.shutdown()
    node.destroy_node()
    sender.destroy_node()


def test_a_node_without_services_has_no_endpoints_but_its_own(context: Context) -> None:
    """The first bird of a process also has what all birds of the process share."""
    first = BirdNode(1, CONFIGURATION, context=context)
    bird = BirdNode(2, CONFIGURATION, context=context, first=first)
    for node, number, shared in ((first, 1, {topics.PROGRESS_TOPIC}), (bird, 2, set())):
        own = {f(number) for f in (topics.wing_topic, topics.stage_topic, topics.state_topic)}
        assert {p.topic_name for p in node.publishers} == own | shared
        known = node.get_publisher_names_and_types_by_node(node.get_name(), "/flock")
        assert {name for name, _ in known} == own | shared | ({"/rosout"} if shared else set())
    for node in (bird, first):
        node.destroy_node()
    served = DrainedNode("served", context=context)
    assert "/parameter_events" in {p.topic_name for p in served.publishers}
    served.destroy_node()


def test_queues_are_as_deep_as_what_may_be_under_way() -> None:
    assert topics.depth(topics.state_topic(1), CONFIGURATION) >= 2
    assert topics.depth(topics.wing_topic(1), CONFIGURATION) == 1
    assert topics.depth(topics.PROGRESS_TOPIC, CONFIGURATION) >= 500  # of all birds of a process
    assert topics.depth(topics.CHECKPOINT_TOPIC, CONFIGURATION) == 1
    assert topics.depth(topics.GRANT_TOPIC, CONFIGURATION) == 1
    assert topics.depth(topics.PERTURBATION_TOPIC, CONFIGURATION) >= 100


@pytest.mark.parametrize("kind", ["events", "single"])
def test_an_executor_of_either_kind_destroys_its_nodes(context: Context, kind: str) -> None:
    from flock_sim.ros.process import executing

    with executing(kind, context) as executor:
        node = Node("guest", context=context)
        executor.add_node(node)
        executor.spin_once(timeout_sec=0.01)
    assert node not in executor.get_nodes()
    with pytest.raises(Exception, match=r"."):
        node.create_publisher(Progress, "late", 1)


def test_a_queue_that_nobody_empties_turns_nothing_away(context: Context) -> None:
    # Another flight on the domain says thousands of stages a second; Fast DDS would keep 5000, and
    # what our own process said then would be lost for good.
    node = DrainedNode("listener", context=context)
    said = node.create_publisher(Progress, topics.PROGRESS_TOPIC, latched(1))
    inlet = node.subscribe_drained(Progress, topics.PROGRESS_TOPIC)
    until(lambda: inlet.connected)
    for step in range(12_000):
        said.publish(messages.Progress(1, step, 1, "somebody").encode())
    heard = [messages.Progress.decode(data).step for data in iter(inlet.take, None)]
    node.destroy_node()
    assert heard == list(range(12_000))


class Stub:
    """An inlet in which messages wait, of somebody who has gone since."""

    connected = False

    def __init__(self, *waiting: bytes) -> None:
        self.waiting = list(waiting)
        self.looks = 0

    def take(self) -> bytes | None:
        self.looks += 1
        return self.waiting.pop(0) if self.waiting else None


def test_what_others_say_is_taken_out_and_is_no_news(context: Context) -> None:
    # No news: a bird whose clock is gone gives up, however much another flock talks.
    bird = BirdNode(2, CONFIGURATION, 7, context=context)
    one = np.ones(1)
    foreign = messages.Stage(8, 0, 1, 1, 0, one, one, one).encode()
    ours = messages.Stage(7, 0, 1, 1, 0, one, one, one).encode()
    for take in (bird.drain, bird.drain_rare):
        bird._stages = {1: Stub(*[foreign] * 100), 3: Stub(foreign)}
        assert not take()
        assert not any(inlet.waiting for inlet in bird._stages.values())
    bird._stages = {1: Stub(*[foreign] * 100, ours), 3: Stub()}
    assert bird.drain()
    bird._wings[1] = Stub(messages.Wing(8, 1, one).encode())
    assert not bird.drain_rare()
    grant = messages.Grant(8, 0, CONFIGURATION.steps, 1.0, 1).encode()
    announcements = Announcements([bird])
    announcements._grants = Stub(grant)
    assert not announcements.drain()
    assert bird.protocol.ignored == 101 + 101 + 100 + 1 + 1
    bird.destroy_node()


def test_a_recorder_that_waits_for_its_flock_empties_its_queues(
    context: Context, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = [100.0]
    monkeypatch.setattr(row_topics.time, "monotonic", lambda: now[0])
    with flock(context, tmp_path) as nodes:
        recorder = nodes["recorder"]
        recorder._grants, recorder._perturbations = Stub(), Stub()
        one = np.ones(1)
        state = messages.State.at(CONFIGURATION, 0, *6 * [one], run_id=8, epoch=1).encode()
        wing = messages.Wing(8, 1, one).encode()
        memory = messages.Memory(8, 0, 1, 1, one).encode()
        states, memories, wings = Stub(state), Stub(memory), Stub(wing)
        heard = recorder._row_topics
        heard._sources = [
            Source(states, recorder.assembler.add_state, 1),
            Source(memories, recorder.assembler.add_memory, 1),
        ]
        heard._wings = [Source(wings, recorder.protocol.receive_wing, 1)]
        heard._times = Stub(messages.Time.at(0).encode())
        recorder.drain()
        assert states.waiting == memories.waiting == heard._times.waiting == []
        assert wings.waiting == [wing], "said once, and it is not known yet whose it must be"
        session = recorder.protocol._session
        session.run_id, session.epoch = 8, 1
        now[0] += 1.0
        recorder.drain()
        assert wings.waiting == []
        assert recorder.assembler._wings == {1: wing}


def test_a_recorder_that_waits_for_a_push_says_its_epoch(context: Context, tmp_path: Path) -> None:
    with flock(context, tmp_path) as nodes:
        protocol = nodes["recorder"].protocol
        assert protocol.report() == []
        grant = messages.Grant(7, 0, 10, 1.0, 5, handshake(CONFIGURATION), 5)
        assert protocol.receive_grant(grant.encode()) == []
        assert not protocol.may_join
        assert protocol.waiting_for == "the clock's perturbation"
        [told] = protocol.report()
        assert (told.run_id, told.epoch, told.step) == (7, 5, ABSENT)


class Joined:
    """The recorder of a flock of three in an epoch that has begun, and stubs for its topics."""

    def __init__(self, recorder: RecorderNode, monkeypatch: pytest.MonkeyPatch) -> None:
        self.recorder = recorder
        self.now = 100.0
        monkeypatch.setattr(row_topics.time, "monotonic", lambda: self.now)
        session = recorder.protocol._session
        session.run_id, session.epoch, recorder.protocol.joined = 7, 1, True
        recorder.assembler.begin(7, 1)
        one = np.ones(1)
        self.wings = [Stub(messages.Wing(7, bird, one).encode()) for bird in (1, 2, 3)]
        self.states = [Stub() for _ in range(3)]
        recorder._grants, recorder._perturbations = Stub(), Stub()
        heard = recorder._row_topics
        heard._times = self.times = Stub()
        heard._wings = [
            Source(stub, recorder.protocol.receive_wing, bird)
            for bird, stub in enumerate(self.wings, 1)
        ]
        heard._sources = [
            Source(stub, recorder.assembler.add_state, bird)
            for bird, stub in enumerate(self.states, 1)
        ]
        recorder.drain()  # the first time, it looks everywhere
        self.looks()

    def say(self, bird: int, step: int, run_id: int = 7) -> None:
        one = np.ones(1)
        state = messages.State.at(CONFIGURATION, step, *6 * [one], run_id=run_id, epoch=1)
        self.states[bird - 1].waiting.append(state.encode())

    def tell(self, step: int) -> None:
        self.times.waiting.append(messages.Time.at(CONFIGURATION.stamp(step)).encode())

    def looks(self) -> tuple[list[int], list[int]]:
        """Return how often each wing and each state was looked for since the last time."""
        counts = tuple([stub.looks for stub in stubs] for stubs in (self.wings, self.states))
        for stub in (*self.wings, *self.states):
            stub.looks = 0
        return counts


@pytest.fixture
def joined(context: Context, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Joined]:
    with flock(context, tmp_path) as nodes:
        yield Joined(nodes["recorder"], monkeypatch)
        monkeypatch.undo()


def test_a_recorder_looks_only_for_a_state_that_the_next_row_lacks(joined: Joined) -> None:
    joined.recorder.drain()
    assert joined.looks() == ([0, 0, 0], [1, 0, 0])
    joined.say(1, 0)
    joined.recorder.drain()  # takes it, and waits for bird 2
    assert joined.looks() == ([0, 0, 0], [2, 1, 0])
    joined.recorder.drain()
    assert joined.looks() == ([0, 0, 0], [0, 1, 0])


def test_a_recorder_takes_rows_whatever_the_order_in_which_states_come(joined: Joined) -> None:
    assembler = joined.recorder.assembler
    # Bird 2 is ahead by a row; then the others follow, the last one first.
    for step in (0, 10):
        joined.tell(step)
        joined.say(2, step)
    joined.recorder.drain()
    for bird in (3, 1):
        joined.say(bird, 0)
        joined.recorder.drain()
    assert assembler.saved == 0
    for bird in (1, 3):
        joined.say(bird, 10)
        joined.recorder.drain()
    assert assembler.saved == 10
    assert assembler.complete


def test_a_recorder_takes_what_others_say_also_where_nothing_is_due(joined: Joined) -> None:
    joined.say(3, 0, run_id=8)
    joined.wings[0].waiting.append(messages.Wing(8, 1, np.ones(1)).encode())
    joined.recorder.drain()
    assert joined.states[2].waiting, "bird 1 is waited for"
    joined.now += LOOK_EVERY
    joined.recorder.drain()
    assert not joined.states[2].waiting
    assert not joined.wings[0].waiting
    assert joined.recorder.assembler.ignored_for == {FOREIGN: 2}
