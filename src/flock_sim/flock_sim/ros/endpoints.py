# SPDX-License-Identifier: Apache-2.0
"""Access of nodes to topics: quality of service, and subscriptions drained by the node."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from typing import Any

from rcl_interfaces.msg import ParameterEvent
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription

from flock_sim.console.signals import Stop
from flock_sim.messages.topics import relative


def latched(depth: int) -> QoSProfile:
    """Return a reliable profile whose last `depth` messages also reach late joiners.

    All of Flock's topics have this kind of profile, so nodes may start in any order.
    """
    return QoSProfile(
        reliability=ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL,
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
    )


ALL = QoSProfile(
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
    history=HistoryPolicy.KEEP_ALL,
)
"""QoS of Flock's subscriptions: keep all messages. A short queue would lose a neighbour's message
if another publisher, such as another flock, sends many on the same topic.

Our settings for Fast DDS (`discovery.py`) remove its limit. By default the queue holds 5000,
rejects further messages, and never requests them again from a writer in the same process. Nodes
also take out messages that they do not wait for."""


def wait_until_heard(outlets: Iterable[Publisher], stop: Stop | bool, limit: float) -> None:
    """Wait until all listeners of `outlets` have their messages, for `limit` s or until `stop`.

    A listener that has not taken them by then is ignored: it may be a killed process, or a
    suspended `ros2 topic echo`.
    """
    deadline = time.monotonic() + limit
    for outlet in outlets:
        while not stop and time.monotonic() < deadline:
            if outlet.wait_for_all_acked(Duration(seconds=0.1)):
                break


class _Silence:
    """Replaces a publisher that is not needed."""

    def publish(self, message: ParameterEvent) -> None:
        """Publish nothing."""


class FlockNode(Node):
    """A node of a flock. Its namespace is that of the flock: `-r __ns:=/left` moves all topics.

    The methods take the names of a flock in the default namespace (`messages/topics.py`).
    """

    def own_topic(self, topic: str) -> str:
        """Return the full name of a topic, in the namespace of this node and remapped."""
        return str(self.resolve_topic_name(relative(topic)))

    def create_publisher(self, msg_type: Any, topic: str, *arguments: Any, **options: Any) -> Any:
        """Make a publisher as rclpy does, in the namespace of this node."""
        return super().create_publisher(msg_type, relative(topic), *arguments, **options)

    def create_subscription(
        self, msg_type: Any, topic: str, *arguments: Any, **options: Any
    ) -> Any:
        """Make a subscription as rclpy does, in the namespace of this node."""
        return super().create_subscription(msg_type, relative(topic), *arguments, **options)


class DrainedNode(FlockNode):
    """A node that takes the messages of some of its subscriptions itself, without an executor.

    An executor spends several times the time on a message that its reading takes. So the node polls
    topics with thousands of messages per second itself, and leaves the rest (waiting, parameters,
    services, rare topics) to the executor.
    """

    _drained: frozenset[Subscription] = frozenset()
    _tells_of_parameters = True

    def __init__(self, name: str, *, start_parameter_services: bool = True, **options: Any) -> None:
        """Make a node as rclpy does; without parameter services it has no services at all.

        It then has no publisher for /parameter_events either: in a process of hundreds of nodes
        each further endpoint costs time at the start.
        """
        self._tells_of_parameters = start_parameter_services
        silent = Parameter("start_type_description_service", value=start_parameter_services)
        super().__init__(
            name,
            start_parameter_services=start_parameter_services,
            parameter_overrides=[silent],
            **options,
        )

    def create_publisher(self, msg_type: Any, topic: str, *arguments: Any, **options: Any) -> Any:
        """Make a publisher as rclpy does, except for parameter events without services."""
        if msg_type is ParameterEvent and not self._tells_of_parameters:
            return _Silence()
        return super().create_publisher(msg_type, topic, *arguments, **options)

    @property
    def subscriptions(self) -> Iterator[Subscription]:
        """The subscriptions that an executor serves."""
        return (s for s in super().subscriptions if s not in self._drained)

    def subscribe_drained(self, message_type: Any, topic: str) -> Inlet:
        """Subscribe to `topic`; the messages wait in the returned inlet."""
        subscription = self.create_subscription(message_type, topic, lambda _: None, ALL, raw=True)
        self._drained |= {subscription}
        return Inlet(subscription)


class Inlet:
    """The queue of one drained subscription."""

    def __init__(self, subscription: Subscription) -> None:
        """Take from `subscription`."""
        self.subscription = subscription
        self.take_raw: Callable[[], tuple[bytes, dict[str, int]] | None] = partial(
            subscription.handle.take_message, subscription.msg_type, True
        )
        """Return the next message as CDR, with its metadata, or None; never waits."""

    @property
    def connected(self) -> bool:
        """Whether its topic has a publisher."""
        return bool(self.subscription.get_publisher_count() > 0)

    def take(self) -> bytes | None:
        """Return the next message as CDR, or None; never waits."""
        taken = self.take_raw()
        return None if taken is None else taken[0]

    def take_with_age(self) -> tuple[bytes, float] | None:
        """Return the next message and how long ago it was sent, in s, or None; never waits.

        The age is measured by the system clocks of sender and receiver.
        """
        taken = self.take_raw()
        if taken is None:
            return None
        data, told = taken
        return data, max(0.0, 1e-9 * (time.time_ns() - told["source_timestamp"]))
