# SPDX-License-Identifier: Apache-2.0
"""A flight of real nodes in this process, whose messages a test carries instead of DDS.

Publishers and drained subscriptions of the nodes are replaced; all other subscriptions are called
as an executor calls them. Time is that of the test.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from rclpy.context import Context
from rclpy.node import Node
from rclpy.subscription import Subscription

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.messages import topics
from flock_sim.nodes import bird, clock, free_bird, recorder, row_topics
from flock_sim.nodes.announcements import Announcements
from flock_sim.nodes.bird import BirdNode
from flock_sim.nodes.clock import ClockNode
from flock_sim.nodes.free_bird import FreeBirdNode
from flock_sim.nodes.recorder import RecorderNode
from flock_sim.protocol.clock import Timekeeper
from flock_sim.recording.flight_writer import recording
from flock_sim.ros import diagnostics, endpoints, rejection_warnings
from flock_sim.ros.endpoints import FlockNode, Inlet
from flock_tools.live import listener

IDLE_ROUNDS = 3
"""Rounds without a message after which the clock rewinds the flock, as its watchdog does."""

TICK = 0.01
"""Time between two rounds without a message, in s."""


class Outlet:
    """Replaces a publisher: its messages go to `sent`."""

    def __init__(self, topic: str, sent: deque[tuple[str, bytes]]) -> None:
        self.topic = topic
        self.handle = SimpleNamespace(publish_raw=self.publish)
        self._sent = sent

    def publish(self, message: Any) -> None:
        if isinstance(message, bytes | memoryview):  # others are diagnostics and parameter events
            self._sent.append((self.topic, bytes(message)))

    def get_subscription_count(self) -> int:
        return 1

    def wait_for_all_acked(self, timeout: object) -> bool:
        return True


class Fed(Inlet):
    """Replaces the queue of a drained subscription: the test fills it."""

    def __init__(self, subscription: Subscription) -> None:
        super().__init__(subscription)
        self.queue: deque[bytes] = deque()
        subscription.fed = self.queue
        self.take_raw = self._take

    @property
    def connected(self) -> bool:
        return True

    def _take(self) -> tuple[bytes, dict[str, int]] | None:
        return (self.queue.popleft(), {}) if self.queue else None

    def take_with_age(self) -> tuple[bytes, float] | None:
        return (self.queue.popleft(), 0.0) if self.queue else None


@dataclass
class Wires:
    """What the nodes of a test have sent, and the time."""

    now: float = 1000.0
    sent: deque[tuple[str, bytes]] = field(default_factory=deque)
    warned: list[str] = field(default_factory=list)

    def monotonic(self) -> float:
        return self.now

    def time_ns(self) -> int:
        return round(1e9 * self.now)


@contextmanager
def wired() -> Iterator[Wires]:
    """Let nodes that are created in the block send to the test, and take from it."""
    wires = Wires()

    def create_publisher(node: FlockNode, kind: Any, topic: str, *_: Any, **__: Any) -> Outlet:
        return Outlet(node.own_topic(topic), wires.sent)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(FlockNode, "create_publisher", create_publisher)
        patch.setattr(endpoints, "Inlet", Fed)
        patch.setattr(bird, "compiled_exchange_of", lambda *_: None)
        patch.setattr(rejection_warnings, "warn", lambda _, text: wires.warned.append(text))
        for module in (bird, row_topics):
            patch.setattr(module, "LOOK_EVERY", 0.0)
        for module in (bird, clock, diagnostics, endpoints, free_bird, listener, recorder):
            patch.setattr(module, "time", wires)
        for module in (bird, free_bird, recorder):
            patch.setattr(module, "new_incarnation", lambda: 1)
        yield wires


def inputs(node: Node) -> dict[str, Callable[[bytes], None]]:
    """Return for each topic that `node` subscribes to the function that hands it a message."""

    def input_of(subscription: Subscription) -> Callable[[bytes], None]:
        if hasattr(subscription, "fed"):
            return subscription.fed.append
        assert subscription.raw, f"{subscription.topic_name} has messages that rclpy reads"
        if subscription._callback_type is Subscription.CallbackType.MessageOnly:
            return subscription.callback
        return lambda data: subscription.callback(
            data, {"source_timestamp": endpoints.time.time_ns()}
        )

    every = Node.subscriptions.fget(node)
    return {each.topic_name: input_of(each) for each in every}


def types_of(node: Node) -> dict[str, str]:
    """Return the message types of the topics that `node` subscribes to."""
    every = Node.subscriptions.fget(node)
    return {each.topic_name: _type_name(each.msg_type) for each in every}


def unread(node: Node) -> dict[str, int]:
    """Return how many messages wait in each queue that `node` drains itself, if any do."""
    every = Node.subscriptions.fget(node)
    return {each.topic_name: len(each.fed) for each in every if len(getattr(each, "fed", ()))}


def _type_name(kind: Any) -> str:
    return f"{kind.__module__.rpartition('.msg.')[0]}/msg/{kind.__name__}"


class WiredFlight:
    """The nodes of a flight, as `fly` creates them, with a clock and a recorder."""

    def __init__(
        self,
        wires: Wires,
        context: Context,
        configuration: FlockConfiguration,
        run: Any,
        run_id: int,
        *,
        factor: float = 0.0,
        stages: bool = False,
        epoch: int = 5,
        by_hand: bool = False,
    ) -> None:
        """Create the nodes. Those by hand take the run id of the first grant."""
        known = 0 if by_hand else run_id
        self.wires = wires
        self.configuration = configuration
        self.factor = factor
        self.sent: list[tuple[str, bytes]] = []
        """The genuine messages, in order."""
        kind: Any = BirdNode
        options: dict[str, Any] = {"context": context}
        if factor:
            kind, options["factor"] = FreeBirdNode, factor
        self.birds = [
            kind(number, configuration, known, **options)
            for number in range(1, configuration.birds + 1)
        ]
        self._announcements = [Announcements([each]) for each in self.birds]
        self.recorder = RecorderNode(
            configuration, run, known, stages, factor=factor, context=context
        )
        keeper = Timekeeper(
            configuration, run_id, 8, True, record_stages=stages, epoch=epoch, factor=factor
        )
        depth = topics.depth(topics.CLOCK_TOPIC, configuration)
        self.clock = ClockNode(keeper, depth, context=context)
        self.nodes: list[Node] = [*self.birds, self.recorder, self.clock]
        self.before: Callable[[str, bytes], None] = lambda topic, data: None
        """Called with a genuine message before it is handed to the nodes."""
        self.after: Callable[[str], None] = lambda topic: None
        """Called after the nodes have acted on a genuine message of a topic."""
        self._listeners: dict[str, list[Callable[[bytes], None]]] = {}
        self._idle = 0
        for node in self.nodes:
            self.add(node)

    def add(self, node: Node) -> None:
        """Let `node` hear the flight."""
        for topic, hear in inputs(node).items():
            self._listeners.setdefault(topic, []).append(hear)

    @property
    def over(self) -> bool:
        return bool(self.recorder.finished)

    def round(self) -> bool:
        """Deliver what was sent, and let each node act; return whether anything was sent."""
        sent = self.wires.sent
        moved = len(sent)
        for _ in range(moved):
            topic, data = sent.popleft()
            self.sent.append((topic, data))
            self.before(topic, data)
            for hear in self._listeners.get(topic, ()):
                hear(data)
            self.act()
            self.after(topic)
        self.act()
        return bool(moved or sent)

    def act(self) -> None:
        """Let each node do what its loop does in one turn."""
        for each, announcements in zip(self.birds, self._announcements, strict=True):
            announcements.drain()
            each.drain()
            each.drain_rare()
            if self.factor:
                each.tick()
        self.recorder.drain()
        self.recorder.keep_safe()
        self.recorder.look_around()
        self.clock.look_around()

    def idle(self) -> None:
        """Let time pass: waiting nodes report, and a flock that stands still is rewound."""
        self.wires.now += 1.0 if not self.factor else TICK
        if self.factor and self.clock.keeper.begun:
            return
        self._idle += 1
        for each in self.birds:
            each.report()
        self.recorder.report()
        self.clock.repeat()
        if self._idle > IDLE_ROUNDS and not self.factor and self.clock.keeper.begun:
            self._idle = 0
            self.clock.rewind()

    def fly(self, rounds: int = 100_000) -> None:
        """Fly to the end."""
        for _ in range(rounds):
            step = self.clock.keeper.step
            if not self.round():
                self.idle()
            if self.clock.keeper.step > step:
                self._idle = 0
            if self.clock.keeper.finished:
                self.clock.release()
            if self.over:
                return
        raise AssertionError(
            f"{self.clock.keeper.where}: {self.clock.keeper.waiting_for}; "
            f"{[each.waiting_for for each in self.birds]}; {self.recorder.waiting_for}"
        )


@contextmanager
def wired_flight(
    context: Context,
    bag: Path,
    configuration: FlockConfiguration,
    run_id: int = 7,
    **options: Any,
) -> Iterator[WiredFlight]:
    """Give a flight that is recorded to `bag`; its nodes are destroyed at the end."""
    factor, stages = options.get("factor", 0.0), options.get("stages", False)
    with (
        wired() as wires,
        recording(bag, configuration, grants=True, stages=stages, factor=factor) as run,
    ):
        flight = WiredFlight(wires, context, configuration, run, run_id, **options)
        try:
            yield flight
        finally:
            for node in flight.nodes:
                node.destroy_node()
