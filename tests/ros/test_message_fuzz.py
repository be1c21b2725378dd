# SPDX-License-Identifier: Apache-2.0
"""Nodes take or refuse any message: no crash, and no effect of one that is invalid.

FLOCK_FUZZ is the number of messages for each test of a node; `make fuzz` sets it.
"""

from __future__ import annotations

import json
import os
import resource
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, nullcontext
from dataclasses import dataclass, field, replace
from functools import cache
from io import StringIO
from pathlib import Path
from random import Random
from typing import Any

import pytest
from hypothesis import given, settings
from rclpy.context import Context
from rclpy.node import Node
from rich.console import Console

from flock_sim.bag.reading.reader import BagReader
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.errors import FlockError, RunFailed
from flock_sim.messages import topics
from flock_sim.messages.cdr import Message
from flock_sim.messages.types import State
from flock_sim.nodes.bird_process import status
from flock_sim.nodes.played_recorder import PlayedRecorderNode
from flock_sim.recording.flight_writer import recording
from flock_sim.ros.diagnostics import Status
from flock_tools.commands.watch import table
from flock_tools.live.listener import Watcher
from flock_tools.live.running_verdict import RunningVerdict
from flock_tools.scene.viewer import Viewer
from support.flights import record
from support.forgeries import forgeries
from support.mutations import KINDS, Mutator
from support.network import expected_states
from support.random_messages import MESSAGES
from support.wired_flight import WiredFlight, inputs, types_of, unread, wired, wired_flight

COUNT = int(os.environ.get("FLOCK_FUZZ", "4000"))
RUN = 7
MOST_MEMORY = 2**29
"""Largest growth of this process in a test, in bytes: what it imports and compiles needs most."""

MOST_WARNINGS = 9
"""Reasons to ignore a message; each process warns of one once."""


@pytest.fixture(autouse=True)
def _keeps_within_memory() -> Iterator[None]:
    before = resident()
    yield
    assert resident() - before < MOST_MEMORY


def resident() -> int:
    """Return the memory of this process, in bytes."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()


@dataclass(frozen=True)
class Flock:
    """A flight, and what its nodes are created with."""

    configuration: FlockConfiguration
    options: dict[str, Any] = field(default_factory=dict)


PLAIN = Flock(
    FlockConfiguration(birds=3, t_max=60.0, record_every=5, span_ratios=("1=0.9,1.0", "2=1.0,1.1")),
    {"stages": True},
)
LINKED = Flock(
    FlockConfiguration(
        birds=3,
        t_max=60.0,
        record_every=5,
        span_ratios=("1=0.9,1.0",),
        links=("hold:delay=3", "2->3=linear:interval=2,delay=3"),
        forcing=("gust:std=1e-3,time=20,seed=1",),
    )
)
FREE = Flock(
    FlockConfiguration(birds=3, t_max=60.0, record_every=5, links=("hold",)), {"factor": 50.0}
)
CASES = {
    "bird": ("bird", PLAIN),
    "bird with links and forcing": ("bird", LINKED),
    "bird in free flight": ("bird", FREE),
    "recorder of stages": ("recorder", PLAIN),
    "recorder of links and forcing": ("recorder", LINKED),
    "recorder of a free flight": ("recorder", FREE),
    "clock": ("clock", PLAIN),
    "clock of a free flight": ("clock", FREE),
    "watch": ("watch", LINKED),
    "view": ("view", PLAIN),
}


@cache  # and not for all kinds at once: each worker imports this module
def strangers(kind: type[Message]) -> list[Message]:
    """Return well-formed random messages."""
    found: list[Message] = []
    quietly = settings(max_examples=100, database=None, derandomize=True, deadline=None)
    quietly(given(MESSAGES[kind])(lambda message: found.append(message)))()
    return found


def target_of(flight: WiredFlight, who: str, held: ExitStack, context: Context) -> Node:
    """Return the node of a flight that is fuzzed; a listener is created and added."""
    if who in ("watch", "view"):
        node = (
            Watcher(context)
            if who == "watch"
            else Viewer(context, 1, FlockConfiguration(), None, odometry=True)
        )
        held.callback(node.destroy_node)
        node.view._now = flight.wires.monotonic
        for bird in range(1, flight.configuration.birds + 1):
            node.listen(bird, topics.state_topic(bird))
        node.birds = frozenset(range(1, flight.configuration.birds + 1))
        flight.add(node)
        return node
    return {"bird": flight.birds[1], "recorder": flight.recorder, "clock": flight.clock}[who]


def run_of(kind: type[Message], run_id: int) -> int | None:
    """Return the run that a node takes messages of; None: any. 0: only played states have a run."""
    return run_id if hasattr(kind, "run_id") and (run_id or kind is State) else None


class Fuzz:
    """Hands messages to a node of a flight, on all topics that it subscribes to."""

    def __init__(self, node: Node, random: Random, run_id: int = RUN) -> None:
        self.given = dict.fromkeys(types_of(node), 0)
        """How many messages were handed over, by topic."""
        self._random = random
        self._hear = inputs(node)
        self._mutators = {
            topic: Mutator(random, KINDS[kind], run_of(KINDS[kind], run_id), strangers(KINDS[kind]))
            for topic, kind in types_of(node).items()
        }
        self._topics = sorted(self._mutators)

    def learn(self, topic: str, data: bytes) -> None:
        if topic in self._mutators:
            self._mutators[topic].learn(data)

    def give(self, count: int, make: Callable[[Mutator], bytes]) -> None:
        for _ in range(count):
            topic = self._random.choice(self._topics)
            self.given[topic] += 1
            self._hear[topic](make(self._mutators[topic]))

    def give_genuine(self, topic: str, data: bytes) -> None:
        self._hear[topic](data)

    @property
    def total(self) -> int:
        return sum(self.given.values())


def bag_content(bag: Path) -> list[tuple[str, int, bytes]]:
    with BagReader(bag) as reader:
        return [(topic, at, bytes(data)) for topic, at, data in reader.messages(reader.topics)]


def assert_bounded(node: Node, warned: list[str]) -> None:
    assert not unread(node)
    nodes = Counter(line.partition(" ")[0] for line in warned)
    assert max(nodes.values(), default=0) <= MOST_WARNINGS
    assert all(line.isprintable() and len(line) < 200 for line in warned)


@dataclass
class Flown:
    """What a flight has sent and recorded, and what a listener has shown of it."""

    sent: list[tuple[str, bytes]]
    bag: list[tuple[str, int, bytes]]
    shown: list[object]


def fly(
    context: Context, bag: Path, flock: Flock, who: str, each: int, random: Random
) -> tuple[Flown, int]:
    """Fly with `each` invalid messages to a node before each message that it hears.

    Returns the number of messages, too.
    """
    shown: list[object] = []
    with (
        wired_flight(context, bag, flock.configuration, RUN, **flock.options) as flight,
        ExitStack() as held,
    ):
        node = target_of(flight, who, held, context)
        fuzz = Fuzz(node, random)

        def before(topic: str, data: bytes) -> None:
            fuzz.learn(topic, data)
            if isinstance(node, Watcher) and node.view.source[0] is None:
                return
            if topic in fuzz.given:
                fuzz.give(each, Mutator.invalid)
                flight.act()

        def after(topic: str) -> None:
            if isinstance(node, Watcher):
                shown.append(node.view.sample(node.birds, 1))
            if isinstance(node, Viewer) and topic == topics.state_topic(3):
                node.publish()

        flight.before, flight.after = before, after
        flight.fly()
        assert_bounded(node, flight.wires.warned)
        assert not each or all(fuzz.given.values()), fuzz.given
    return Flown(flight.sent, bag_content(bag), shown), fuzz.total


@pytest.mark.parametrize(
    "case", [pytest.param(case, marks=pytest.mark.slow if case == "view" else ()) for case in CASES]
)
def test_no_invalid_message_has_an_effect(context: Context, tmp_path: Path, case: str) -> None:
    who, flock = CASES[case]
    random = Random(case)
    calm, _ = fly(context, tmp_path / "calm", flock, who, 0, random)
    each = min(1 + COUNT // len(calm.sent), 1000)
    given = 0
    while given < COUNT:
        bag = tmp_path / f"fuzzed{given}"
        fuzzed, count = fly(context, bag, flock, who, each, random)
        assert fuzzed.sent == calm.sent
        assert fuzzed.shown == calm.shown
        assert fuzzed.bag == calm.bag
        given += count
    assert only_bags(tmp_path)
    if not flock.options.get("factor"):
        states = expected_states(flock.configuration)
        for bird, expected in states.items():
            name = topics.state_topic(bird)
            assert [data for topic, _, data in calm.bag if topic == name] == expected


def only_bags(directory: Path) -> bool:
    """Whether nothing but bags and logs were written to a directory."""
    kinds = {each.name.rstrip("0123456789") for each in directory.iterdir()}
    return kinds <= {"calm", "fuzzed", "log"}


MOST_EACH = 50
"""Most messages of any kind that a flight has for each genuine one."""

MOST_WAITING = 100
"""Messages on their way among which there are no more of these: each may cause several others."""

SHOWN = 0.05
"""Part of the messages of a flight after which a listener shows it."""

MOST_ROUNDS = 300
"""Rounds of a flight among any messages: they may keep it from its end."""


DOCUMENTED = (
    "give both the same configuration",
    "a free flight can't return to an earlier step: fly again",
    "end it first, or give this one another run_id",
    "the members of the flock",
    "give it the configuration of the played flight",
)
"""Ends of the errors that end a node or a tool: another flight is flown or played."""

MISSED = "was not received: start the recorder first"


@contextmanager
def refusals() -> Iterator[None]:
    """Allow the documented refusals."""
    try:
        yield
    except (FlockError, RunFailed) as error:
        if not (str(error).endswith(DOCUMENTED) or MISSED in str(error)):
            raise AssertionError(f"an undocumented refusal: {error}") from error


@pytest.mark.parametrize("case", CASES)
def test_no_message_stops_a_node_but_by_a_documented_refusal(
    context: Context, tmp_path: Path, case: str
) -> None:
    who, flock = CASES[case]
    random = Random(case)
    given = flights = 0
    while given < COUNT:
        bag, flights = tmp_path / f"fuzzed{flights}", flights + 1
        by_hand = flights % 4 == 0
        given += fly_among_anything(context, bag, flock, who, random, by_hand)
    assert only_bags(tmp_path)


def fly_among_anything(
    context: Context, bag: Path, flock: Flock, who: str, random: Random, by_hand: bool
) -> int:
    """Fly among messages of any kind to a node; return their number."""
    options = {**flock.options, "by_hand": by_hand}
    with (
        wired_flight(context, bag, flock.configuration, RUN, **options) as flight,
        ExitStack() as held,
    ):
        node = target_of(flight, who, held, context)
        fuzz = Fuzz(node, random)

        def before(topic: str, data: bytes) -> None:
            fuzz.learn(topic, data)
            if len(flight.wires.sent) > MOST_WAITING:
                return
            for _ in range(random.choice((1, 5, MOST_EACH))):
                with refusals():
                    fuzz.give(1, Mutator.anything)
            with refusals():
                flight.act()
            if isinstance(node, Watcher) and random.random() < SHOWN:
                with refusals():
                    show(node, random.choice((1, 1, 2)))

        flight.before = before
        for _ in range(MOST_ROUNDS):
            with refusals():
                if not flight.round():
                    flight.idle()
            if flight.over or flight.clock.keeper.lost or fuzz.total > COUNT:
                break
        for _ in range(MOST_ROUNDS):
            with refusals():  # a refusal leaves what comes after it
                flight.act()
                if not unread(node):  # a bird in flight looks at one wing at a time
                    break
        assert_bounded(node, flight.wires.warned)
        for each in flight.birds:
            assert_reportable(status([each]))
        assert_reportable(flight.clock._status())
        assert_reportable(flight.recorder._status())
    return fuzz.total


def show(node: Watcher, member: int) -> None:
    """Show what a listener has received, as its tool does."""
    if isinstance(node, Viewer):
        node.publish()
    sample = node.view.sample(node.birds, member)
    if sample is not None:
        verdict = RunningVerdict()
        verdict.see(sample)
        told = table(sample, node.view.unreadable, verdict.told(node.view.flown))
        with StringIO() as screen:
            Console(file=screen, width=200).print(told)
            assert screen.getvalue().replace("\n", "").isprintable()
        json.dumps(sample.as_json(), allow_nan=False)


@pytest.mark.parametrize("seed", range(max(1, COUNT // 20_000)))
def test_forged_control_messages_of_the_own_run_change_no_value(
    context: Context, tmp_path: Path, seed: int
) -> None:
    flown = FlockConfiguration(birds=3, t_max=200.0, record_every=5, span_ratios=("2=0.97,1.03",))
    random, genuine = Random(seed), dict[str, bytes]()
    heard = (topics.GRANT_TOPIC, topics.PROGRESS_TOPIC)
    forged = rewinds = 0
    with wired_flight(context, tmp_path / "bag", flown, RUN) as flight:
        made = forgeries(random, genuine)

        def before(topic: str, data: bytes) -> None:
            nonlocal forged
            if topic in heard:
                genuine[topic] = data
            if len(genuine) < len(heard) or random.random() > 0.01 or not flight.clock.keeper.begun:
                return
            _, to, message = next(made)
            forged += 1
            for node in flight.nodes:
                if to in (own := inputs(node)):
                    own[to](message)
            flight.act()

        flight.before = before
        flight.fly()
        rewinds = flight.clock.keeper.rewinds.count
    assert forged > 10
    assert rewinds
    content = bag_content(tmp_path / "bag")
    for bird, states in expected_states(flown).items():
        recorded = [data for topic, _, data in content if topic == topics.state_topic(bird)]
        assert recorded == states


@pytest.mark.parametrize("beyond", [0, 1], ids=["an end", "a release"])
@pytest.mark.parametrize("rewound", [False, True], ids=["in flight", "after a rewind"])
def test_a_forged_end_does_not_end_a_flight(
    context: Context, tmp_path: Path, rewound: bool, beyond: int
) -> None:
    flown = FlockConfiguration(birds=3, t_max=60.0, record_every=5)
    forged = 0
    with wired_flight(context, tmp_path / "bag", flown, RUN) as flight:
        keeper = flight.clock.keeper

        def before(topic: str, data: bytes) -> None:
            nonlocal forged
            if forged == 3 or keeper.step < 15 * (1 + forged):
                return
            forged += 1
            if rewound:  # nobody is granted a step then, so that any end is possible
                flight.clock.rewind()
            end = keeper.grant.step + 4
            for grant in (keeper.grant, replace(keeper.grant, step=end + beyond, end=end)):
                for node in flight.nodes:
                    if hear := inputs(node).get(topics.GRANT_TOPIC):
                        hear(grant.encode())
            flight.act()

        flight.before = before
        flight.fly()
    assert forged == 3
    content = bag_content(tmp_path / "bag")
    for bird, states in expected_states(flown).items():
        assert [data for topic, _, data in content if topic == topics.state_topic(bird)] == states


@pytest.mark.parametrize("end", [20, 60], ids=["stopped", "flown to its end"])
def test_a_stopped_flight_is_ended_twice(context: Context, tmp_path: Path, end: int) -> None:
    flown = FlockConfiguration(birds=3, t_max=60.0, record_every=5)
    with wired_flight(context, tmp_path / "bag", flown, RUN) as flight:
        keeper = flight.clock.keeper

        def before(topic: str, data: bytes) -> None:
            if not keeper.stopped and keeper.grant.step >= end < flown.steps:
                flight.wires.sent.extend((topics.GRANT_TOPIC, m.encode()) for m in keeper.stop())

        flight.before = before
        flight.fly()
        flight.wires.sent.clear()
        flight.clock.release()
        last = [data for topic, data in flight.wires.sent if topic == topics.GRANT_TOPIC]
    assert last == (2 if keeper.stopped else 1) * [keeper.release.encode()]
    assert keeper.stopped == (end < flown.steps)
    content = bag_content(tmp_path / "bag")
    for bird, states in expected_states(flown).items():
        recorded = [data for topic, _, data in content if topic == topics.state_topic(bird)]
        assert recorded == states[: 1 + keeper.end // flown.record_every]


PLAYED = FlockConfiguration(birds=3, t_max=60.0, record_every=5, span_ratios=("1=0.9,1.0",))


@pytest.mark.parametrize("make", [Mutator.invalid, Mutator.anything], ids=["invalid", "anything"])
def test_a_played_flight_is_recorded_among_any_messages(
    context: Context, tmp_path: Path, make: Callable[[Mutator], bytes]
) -> None:
    allowed = nullcontext if make is Mutator.invalid else refusals
    source = record(tmp_path / "calm", PLAYED, grants=True, run_id=RUN)
    played, random = bag_content(source), Random(1)
    each, given, flights = min(1 + COUNT // len(played), 1000), 0, 0
    while given < COUNT:
        bag, flights = tmp_path / f"fuzzed{flights}", flights + 1
        with wired(), recording(bag, PLAYED, grants=False, live=True) as run:
            node = PlayedRecorderNode(PLAYED, run, context)
            fuzz = Fuzz(node, random, 0)
            for topic, _, data in played:
                fuzz.learn(topic, data)
                for _ in range(each):
                    fuzz.give(1, make)
                    with allowed():
                        node.drain()
                fuzz.give_genuine(topic, data)
                with allowed():
                    node.drain()
            assert_bounded(node, [])
            given += fuzz.total
            node.destroy_node()
        if make is Mutator.invalid:
            states = [entry for entry in bag_content(bag) if entry[0].endswith("/state")]
            assert states == [entry for entry in played if entry[0].endswith("/state")]
    assert only_bags(tmp_path)


def assert_reportable(told: Status) -> None:
    """Assert that a node can publish its diagnostics: few short and printable texts."""
    _, words, values = told
    assert len(values) < 30
    for text in (words, *values, *map(str, values.values())):
        assert text.isprintable()
        assert len(text) < 300
