# SPDX-License-Identifier: Apache-2.0
"""The node that plays: its publishers, and the services that rosbag2's player has."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Mapping
from concurrent.futures import Future
from concurrent.futures import TimeoutError as NotServed
from contextlib import suppress
from typing import Any

from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import HistoryPolicy, ReliabilityPolicy

from flock_sim.core import topics
from flock_sim.nodes.endpoints import wait_until_heard
from flock_sim.stop import Stop
from flock_tools.play_topics import Playable
from flock_tools.playback import Playback

try:
    from rosbag2_interfaces import srv
except ImportError:
    from flock_interfaces import srv

PATIENCE = 10.0
"""Time, in s, that a listener may take for what it was sent; losses are looked for every 3 s."""

AT_ONCE = 256
"""Messages under way at `--rate 0`, on all topics."""

MEET_EVERY = 0.02
"""Time, in s, between two looks whether all who listen are connected."""

NEWS, NOBODY = 0.5, 3.5
"""Time, in s, without news of more listeners after which those who were there are all known, and
from the start of the player on, after which there are none. Who knows the player is known to it a
tenth of a second later; who is there already makes itself known every 3 s."""

SERVED_WITHIN = 10.0
"""Time, in s, within which the playback answers a service: it may be publishing just then."""


class Player(Node):
    """Publishes recorded bytes, and serves `~/pause ~/resume ~/seek` and the like."""

    def __init__(self, playable: Mapping[str, Playable], context: Context) -> None:
        """Offer the topics of `playable`."""
        super().__init__(
            "player",
            namespace=topics.NAMESPACE,
            context=context,
            start_parameter_services=False,
            enable_rosout=False,
        )
        self._outlets: dict[str, Publisher] = {
            name: self.create_publisher(topic.type, name, topic.qos)
            for name, topic in playable.items()
        }
        self._room = {
            name: topic.qos.depth if topic.qos.history == HistoryPolicy.KEEP_LAST else AT_ONCE
            for name, topic in playable.items()
            if topic.qos.reliability == ReliabilityPolicy.RELIABLE
        }
        self._unheard: Counter[str] = Counter()
        self._made = time.monotonic()

    def say(self, topic: str, data: bytes) -> None:
        """Publish recorded bytes."""
        self._outlets[topic].publish(data)

    def say_when_heard(self, topic: str, data: bytes) -> None:
        """Do so once those who listen have what would be pushed out of a queue by it.

        Whoever does not take what is said on a topic for `PATIENCE` s is left behind on it.
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
        if patient and not self._outlets[topic].wait_for_all_acked(Duration(seconds=PATIENCE)):
            del self._room[topic]
        del self._unheard[topic]

    def meet(self, stop: Stop) -> None:
        """Wait until those who listen already are connected, so that they hear the beginning."""
        begun = changed = time.monotonic()
        known = 0
        while not stop and (now := time.monotonic()) - begun < PATIENCE:
            listeners = sum(outlet.get_subscription_count() for outlet in self._outlets.values())
            if listeners != known or not self._met():
                known, changed = listeners, now
            elif now > max(changed + NEWS, 0.0 if known else self._made + NOBODY):
                return
            time.sleep(MEET_EVERY)

    def wait_until_heard(self, stop: Stop) -> None:
        """Wait until all who listen, or are about to, have what was sent; only so long."""
        deadline = time.monotonic() + PATIENCE
        while not stop and time.monotonic() < deadline and not self._met():
            time.sleep(MEET_EVERY)
        wait_until_heard(self._outlets.values(), stop, PATIENCE)

    def _met(self) -> bool:
        """Whether every listener that was found has been connected to."""
        return all(
            outlet.get_subscription_count() >= self.count_subscribers(name)
            for name, outlet in self._outlets.items()
        )

    def serve(self, playback: Playback) -> None:
        """Offer the services that operate `playback`."""
        schedule = playback.schedule
        for kind, name, operate, result in (
            (srv.Pause, "pause", lambda _: schedule.pause(), None),
            (srv.Resume, "resume", lambda _: schedule.resume(), None),
            (srv.TogglePaused, "toggle_paused", lambda _: playback.toggle_paused(), None),
            (srv.IsPaused, "is_paused", lambda _: schedule.paused, "paused"),
            (srv.SetRate, "set_rate", lambda asked: playback.set_rate(asked.rate), "success"),
            (srv.GetRate, "get_rate", lambda _: schedule.rate, "rate"),
            (srv.Seek, "seek", lambda asked: playback.seek(_stamp(asked.time)), "success"),
            (srv.PlayNext, "play_next", lambda _: playback.play_next(), "success"),
            (srv.Stop, "stop", lambda _: playback.stop(), None),
        ):

            def answer(
                request: Any, response: Any, operate: Any = operate, result: Any = result
            ) -> Any:
                said: Future[Any] = playback.ask(lambda: operate(request))
                with suppress(NotServed):  # the playback is over: nothing was done
                    value = said.result(SERVED_WITHIN)
                    if result is not None:
                        setattr(response, result, value)
                return response

            self.create_service(kind, f"~/{name}", answer)


def _stamp(recorded: Any) -> int:
    """Return a builtin_interfaces/Time in ns."""
    return int(recorded.sec) * 1_000_000_000 + int(recorded.nanosec)
