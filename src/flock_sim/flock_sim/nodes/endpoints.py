# SPDX-License-Identifier: Apache-2.0
"""How nodes reach topics: quality of service, and subscriptions that are drained by hand."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from typing import Any

from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription

from flock_sim.stop import Stop


def latched(depth: int) -> QoSProfile:
    """Return a reliable profile whose last `depth` messages also reach those who come later.

    All of Flock's topics are of this kind: nobody has to be up before anybody else.
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
"""How Flock's nodes listen: to everything. A queue of the last few would lose what a neighbour said
when somebody else, another flock say, talks much on the same topic.

It has no limit, by our settings for Fast DDS (`discovery.py`): by default it holds 5000, turns away
what comes then, and of a writer in the same process never asks for it again. What is not waited for
is taken out of it, too."""


def wait_until_heard(outlets: Iterable[Publisher], stop: Stop | bool, limit: float) -> None:
    """Wait until all who listen to `outlets` have their messages, for `limit` s or until `stop`.

    Whoever has not taken them by then, a suspended `ros2 topic echo` or somebody who was killed, is
    left behind.
    """
    deadline = time.monotonic() + limit
    for outlet in outlets:
        while not stop and time.monotonic() < deadline:
            if outlet.wait_for_all_acked(Duration(seconds=0.1)):
                break


class DrainedNode(Node):
    """A node some of whose subscriptions no executor serves: it takes their messages itself.

    An executor spends several times longer on a message than the message takes to be read; where
    messages come in thousands a second, the node looks for them itself and leaves the rest
    (waiting, parameters, services, rare topics) to the executor.
    """

    _drained: frozenset[Subscription] = frozenset()

    def __init__(self, name: str, *, start_parameter_services: bool = True, **options: Any) -> None:
        """Make a node as rclpy does; without services for parameters, there are none at all."""
        silent = Parameter("start_type_description_service", value=start_parameter_services)
        super().__init__(
            name,
            start_parameter_services=start_parameter_services,
            parameter_overrides=[silent],
            **options,
        )

    @property
    def subscriptions(self) -> Iterator[Subscription]:
        """The subscriptions that an executor is to serve."""
        return (s for s in super().subscriptions if s not in self._drained)

    def subscribe_drained(self, message_type: Any, topic: str) -> Inlet:
        """Subscribe to `topic`; the messages wait in the returned inlet."""
        subscription = self.create_subscription(message_type, topic, lambda _: None, ALL, raw=True)
        self._drained |= {subscription}
        return Inlet(subscription)


class Inlet:
    """Where the messages of one drained subscription wait."""

    def __init__(self, subscription: Subscription) -> None:
        """Take from `subscription`."""
        self.subscription = subscription
        self.take_raw: Callable[[], tuple[bytes, dict[str, int]] | None] = partial(
            subscription.handle.take_message, subscription.msg_type, True
        )
        """Return the next message as CDR, with what is told of it, or None; never waits."""

    @property
    def connected(self) -> bool:
        """Whether somebody publishes to it."""
        return bool(self.subscription.get_publisher_count() > 0)

    def take(self) -> bytes | None:
        """Return the next message as CDR, or None; never waits."""
        taken = self.take_raw()
        return None if taken is None else taken[0]

    def take_with_age(self) -> tuple[bytes, float] | None:
        """Return the next message and how long ago it was sent, in s, or None; never waits.

        The age is by the system's time, here and where the message was sent.
        """
        taken = self.take_raw()
        if taken is None:
            return None
        data, told = taken
        return data, max(0.0, 1e-9 * (time.time_ns() - told["source_timestamp"]))
