# SPDX-License-Identifier: Apache-2.0
"""A node that listens to any flock that is flown or played, without an effect on it."""

from __future__ import annotations

import math
import os
import re
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TypeVar

import rclpy
from rclpy.context import Context
from rclpy.executors import Executor

from flock_interfaces.msg import BirdState, Grant
from flock_sim.console.signals import Stop
from flock_sim.errors import RunFailed
from flock_sim.messages import topics
from flock_sim.ros.discovery import DOMAIN
from flock_sim.ros.endpoints import FlockNode, latched
from flock_sim.ros.log import ros_context
from flock_sim.ros.process import executing
from flock_sim.ros.settings_check import check_settings
from flock_tools.live.flock_monitor import Sample, View
from flock_tools.live.players import Publisher

REFRESH = 0.25
"""Interval between updates of the table, and between searches for topics, in s."""

SETTLED = 1.0
"""Time without a new bird after which all birds count as found, without a clock, in s."""

DEPTH = 64
"""Queue depth of a topic. A flock that is faster than this node is sampled. Several flights may
latch their grants and wings on the same topics."""

PARTICIPANT = 12
"""Number of bytes of an endpoint's global id (GUID) that its process has given to all of them."""

UNNAMED = "_NODE_NAME_UNKNOWN_"
"""The node name, in ROS 2, of an endpoint whose node has not been discovered."""

Listener = TypeVar("Listener", bound="Watcher")


class Watcher(FlockNode):
    """Listens to the states of all birds that it finds, and to the grants of their clock."""

    def __init__(self, context: Context, name: str = "watch") -> None:
        """Create the node, whose name is `name` and the process id."""
        super().__init__(
            f"{name}_{os.getpid()}",
            namespace=topics.NAMESPACE,
            context=context,
            start_parameter_services=False,
            enable_rosout=False,
        )
        self._state_topic = re.compile(re.escape(self.get_namespace()) + r"/bird_(\d+)/state")
        self.view = View()
        self.birds: frozenset[int] = frozenset()
        """The birds whose states are published; after the end of a flight, the last ones."""
        self._heard: set[int] = set()
        self._found_at = 0.0
        self.create_subscription(
            Grant, topics.GRANT_TOPIC, self.view.hear_grant, latched(DEPTH), raw=True
        )
        self.create_timer(REFRESH, self.look_around)

    def look_around(self) -> None:
        """Subscribe to newly found birds, and find out which nodes publish their states.

        Topics that are only subscribed to, such as by another `watch`, are of no bird.
        """
        states: dict[int, frozenset[Publisher]] = {}
        for name, _ in self.get_topic_names_and_types():
            match = self._state_topic.fullmatch(name)
            if match and (found := self.publishers_of(name)):
                states[int(match[1])] = found
                if int(match[1]) not in self._heard:
                    self.listen(int(match[1]), name)
        self.view.see_publishers(states, self.publishers_of(self.own_topic(topics.GRANT_TOPIC)))
        if states and states.keys() != self.birds:
            self.birds = frozenset(states)
            self._found_at = time.monotonic()

    def knows(self, sample: Sample) -> bool:
        """Whether discovery is complete: by a grant, or without a clock and without new birds."""
        if sample.coupling is not None:
            return True
        settled = time.monotonic() - self._found_at > SETTLED
        return settled and not self.view.awaits_grant

    def listen(self, bird: int, topic: str) -> None:
        """Subscribe to the states of `bird`."""

        def hear(data: bytes, told: Mapping[str, int]) -> None:
            self.view.hear_state(bird, data, 1e-9 * (time.time_ns() - told["source_timestamp"]))

        self._heard.add(bird)
        self.create_subscription(BirdState, topic, hear, latched(DEPTH), raw=True)

    def publishers_of(self, topic: str) -> frozenset[Publisher]:
        """Return the nodes that publish `topic`."""
        return frozenset(
            Publisher(
                ""
                if each.node_name == UNNAMED
                else f"{each.node_namespace.rstrip('/')}/{each.node_name}",
                tuple(each.endpoint_gid[:PARTICIPANT]),
            )
            for each in self.get_publishers_info_by_topic(topic)
        )


@contextmanager
def watching(
    make: Callable[[Context], Listener], ros_arguments: Sequence[str] = ()
) -> Iterator[tuple[Listener, Executor]]:
    """Give the node that `make` creates, and its executor. Remove both at the end."""
    context = ros_context(ros_arguments)
    try:
        with executing("single", context) as executor:
            watcher = make(context)
            executor.add_node(watcher)
            check_settings(context.get_domain_id())
            yield watcher, executor
    finally:
        rclpy.try_shutdown(context=context)


def first_sample(
    watcher: Watcher, executor: Executor, member: int, timeout: float, stop: Stop
) -> Sample | None:
    """Return the first sample of `member`; None on `stop`.

    Raises RunFailed if no sample is received within `timeout` s.
    """
    deadline = time.monotonic() + timeout
    behind = math.inf
    while not stop:
        serve(executor, min(REFRESH, timeout), stop)
        sample = watcher.view.sample(watcher.birds, 1)
        if sample is not None and watcher.knows(sample):
            # Birds give a late joiner their last states, which are taken one after the other.
            if behind - watcher.view.behind < REFRESH:
                return watcher.view.sample(watcher.birds, member)
            behind = watcher.view.behind
        if time.monotonic() > deadline:
            if sample is not None:
                return watcher.view.sample(watcher.birds, member)
            found = f"only birds {sorted(watcher.birds)}" if watcher.birds else "no flock"
            raise RunFailed(
                f"{found} found within {timeout:g} s on ROS domain {os.environ.get(DOMAIN) or 0}:"
                f" fly or play one there, set {DOMAIN} to its domain, or give a longer --timeout"
            )
    return None


def serve(executor: Executor, duration: float, stop: Stop) -> None:
    """Serve the executor for `duration`, in s, or until `stop`."""
    until = time.monotonic() + duration
    while not stop and (left := until - time.monotonic()) > 0.0:
        executor.spin_once(timeout_sec=left)
