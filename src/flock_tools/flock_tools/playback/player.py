# SPDX-License-Identifier: Apache-2.0
"""The node that plays: its publishers, and the services of rosbag2's player."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Mapping, Sequence
from concurrent.futures import Future
from concurrent.futures import TimeoutError as NotServed
from contextlib import suppress
from typing import Any

from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.publisher import Publisher
from rclpy.qos import HistoryPolicy, ReliabilityPolicy
from rosgraph_msgs.msg import Clock

from flock_sim.console.signals import Stop
from flock_sim.errors import FlockError
from flock_sim.messages import topics
from flock_sim.messages.cdr import ENCAPSULATION
from flock_sim.messages.types import Time
from flock_sim.nodes.own_birds import announce
from flock_sim.ros.endpoints import FlockNode, wait_until_heard
from flock_tools.playback.loop import NotPublishable, Playback
from flock_tools.playback.message_types import service_class
from flock_tools.playback.schedule import BILLION
from flock_tools.playback.topics import Playable

MEET_TIMEOUT = 10.0
"""Longest wait for listeners, in s; lost messages are detected every 3 s."""

AT_ONCE = 256
"""Largest number of unacknowledged messages at `--rate 0`, over all topics."""

MEET_EVERY = 0.02
"""Interval between checks for the connection of all listeners, in s."""

NEWS, NOBODY = 0.5, 3.5
"""Time without a new listener after which all listeners are known, and time from the player's start
after which it has none, in s. A listener that has discovered the player is discovered 0.1 s later;
existing participants announce themselves every 3 s."""

LATEST = 2**31 * BILLION - 1
"""The latest time that a message of /clock can hold, in ns."""

SERVED_WITHIN = 10.0
"""Longest wait of a service for the playback, which may be publishing, in s."""


class Player(FlockNode):
    """Publishes recorded bytes, and serves `~/pause ~/resume ~/seek` and the like."""

    def __init__(
        self,
        playable: Mapping[str, Playable],
        context: Context,
        own_birds: Sequence[str] = (),
        *,
        clock: bool = False,
    ) -> None:
        """Create the publishers of `playable`, and with `clock` that of /clock.

        `own_birds` are names in the bag, for recorders.
        """
        super().__init__(
            "player",
            namespace=topics.NAMESPACE,
            context=context,
            start_parameter_services=False,
            enable_rosout=False,
        )
        for name in own_birds:
            announce(self, name)
        self._outlets: dict[str, Publisher] = {
            name: self._outlet(name, topic) for name, topic in playable.items()
        }
        if clock:
            self._outlets[topics.CLOCK_TOPIC] = self.create_publisher(Clock, topics.CLOCK_TOPIC, 1)
        self._room = {
            name: topic.qos.depth if topic.qos.history == HistoryPolicy.KEEP_LAST else AT_ONCE
            for name, topic in playable.items()
            if topic.qos.reliability == ReliabilityPolicy.RELIABLE
        }
        self._unheard: Counter[str] = Counter()
        self._made = time.monotonic()

    def _outlet(self, name: str, topic: Playable) -> Publisher:
        """Create a publisher; raises FlockError if the node has the topic with another type."""
        try:
            return self.create_publisher(topic.type, name, topic.qos)
        except rclpy_implementation.RCLError as error:
            raise FlockError(
                f"{name} can't be published: {error}; leave it out by --exclude-topics {name}"
            ) from error

    def say(self, topic: str, data: bytes) -> None:
        """Publish recorded bytes. Raises NotPublishable if they do not fit the topic."""
        check_cdr(data)
        try:
            self._outlets[topic].publish(data)
        except rclpy_implementation.RCLError as error:
            raise NotPublishable(f"{len(data)} bytes do not fit its type") from error

    def tick(self, stamp: int) -> None:
        """Publish recorded time `stamp`, in ns, on /clock. The player must have been given one."""
        self.say(topics.CLOCK_TOPIC, Time.at(min(stamp, LATEST)).encode())

    def say_when_heard(self, topic: str, data: bytes) -> None:
        """Publish once listeners have acknowledged the messages that it would push out of a queue.

        After a wait of `MEET_TIMEOUT` s without success, the topic is no longer waited for.
        """
        if self._unheard[topic] >= self._room.get(topic, AT_ONCE):
            self._wait_for(topic)
        if self._unheard.total() >= AT_ONCE:
            for name in list(self._unheard):
                self._wait_for(name)
        self._unheard[topic] += 1
        self.say(topic, data)

    def _wait_for(self, topic: str) -> None:
        patient = topic in self._room
        if patient and not self._outlets[topic].wait_for_all_acked(Duration(seconds=MEET_TIMEOUT)):
            del self._room[topic]
        del self._unheard[topic]

    def meet(self, stop: Stop) -> None:
        """Wait until existing listeners are connected, so that they receive the beginning."""
        begun = changed = time.monotonic()
        known = 0
        while not stop and (now := time.monotonic()) - begun < MEET_TIMEOUT:
            listeners = sum(outlet.get_subscription_count() for outlet in self._outlets.values())
            if listeners != known or not self._met():
                known, changed = listeners, now
            elif now > max(changed + NEWS, 0.0 if known else self._made + NOBODY):
                return
            time.sleep(MEET_EVERY)

    def wait_until_heard(self, stop: Stop) -> None:
        """Wait until all listeners, also new ones, have all messages. The wait is limited."""
        deadline = time.monotonic() + MEET_TIMEOUT
        while not stop and time.monotonic() < deadline and not self._met():
            time.sleep(MEET_EVERY)
        wait_until_heard(self._outlets.values(), stop, MEET_TIMEOUT)

    def _met(self) -> bool:
        """Whether all discovered listeners are connected."""
        return all(
            outlet.get_subscription_count() >= self.count_subscribers(outlet.topic_name)
            for outlet in self._outlets.values()
        )

    def serve(self, playback: Playback) -> None:
        """Create the services that control `playback`."""
        schedule = playback.schedule
        for kind, name, operate, result in (
            ("Pause", "pause", lambda _: schedule.pause(), None),
            ("Resume", "resume", lambda _: schedule.resume(), None),
            ("TogglePaused", "toggle_paused", lambda _: playback.toggle_paused(), None),
            ("IsPaused", "is_paused", lambda _: schedule.paused, "paused"),
            ("SetRate", "set_rate", lambda asked: playback.set_rate(asked.rate), "success"),
            ("GetRate", "get_rate", lambda _: schedule.rate, "rate"),
            ("Seek", "seek", lambda asked: playback.seek(_stamp(asked.time)), "success"),
            ("PlayNext", "play_next", lambda _: playback.play_next(), "success"),
            ("Stop", "stop", lambda _: playback.stop(), None),
        ):

            def answer(
                request: Any, response: Any, operate: Any = operate, result: Any = result
            ) -> Any:
                said: Future[Any] = playback.ask(lambda: operate(request))
                with suppress(NotServed):  # the playback did not serve the request
                    value = said.result(SERVED_WITHIN)
                    if result is not None:
                        setattr(response, result, value)
                return response

            self.create_service(service_class(kind), f"~/{name}", answer)


def check_cdr(data: bytes) -> None:
    """Raise NotPublishable for bytes that do not begin as CDR, such as compressed bytes."""
    if len(data) < len(ENCAPSULATION) or data[0] != ENCAPSULATION[0]:
        raise NotPublishable("their bytes are not CDR")


def _stamp(recorded: Any) -> int:
    """Return a builtin_interfaces/Time in ns."""
    return int(recorded.sec) * BILLION + int(recorded.nanosec)
