# SPDX-License-Identifier: Apache-2.0
"""The node that shows a flock in space."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from functools import partial
from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np
from rclpy.context import Context
from rclpy.publisher import Publisher

from flock_interfaces.msg import BirdWing
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.errors import FlockError
from flock_sim.messages import topics
from flock_sim.messages.types import State
from flock_sim.physics.arrays import FloatArray
from flock_sim.physics.flock_state import FlockState
from flock_sim.ros.endpoints import latched
from flock_tools.live.flock_monitor import Sample
from flock_tools.live.listener import DEPTH, Watcher
from flock_tools.scene.frame import (
    ODOMETRY_DEPTH,
    TOPICS,
    TRAIL,
    TRANSFORM_TOPIC,
    Frame,
    odometry_topic,
)
from flock_tools.scene.messages import ODOMETRY, TRANSFORMS
from flock_tools.scene.snapshot import Snapshot

if TYPE_CHECKING:
    from flock_tools.scene.foxglove_server import FoxgloveServer

FOXGLOVE_TYPES = {name: topic.type for name, topic in TOPICS.items() if name != TRANSFORM_TOPIC}
"""Topics offered to Foxglove, and their types. The transform is on /tf, as Foxglove expects."""


class Viewer(Watcher):
    """Publishes one member of a flock as markers, at each call of `publish`.

    It publishes only on its own topics, and creates only messages that have a listener.
    """

    def __init__(
        self,
        context: Context,
        member: int,
        assumed: FlockConfiguration,
        foxglove: FoxgloveServer | None,
        odometry: bool = False,
    ) -> None:
        """Show `member`, from 1. `assumed` is the configuration if no clock gives one.

        With `odometry`, it publishes the Odometry of each bird, too. Raises FlockError if nav_msgs
        is not installed then.
        """
        odometry_type = _message_class(ODOMETRY) if odometry else None
        super().__init__(context, "view")
        self._member = member
        self._assumed = assumed
        self._foxglove = foxglove
        self._trail: deque[FloatArray] = deque(maxlen=TRAIL)
        self._frame: Frame | None = None
        self._shown: State | None = None
        self._source: object = None
        self._odometry_type = odometry_type
        self._birds: dict[int, Publisher] = {}
        """The publisher of the Odometry of each bird so far."""
        self._outlets = [
            (self.create_publisher(kind, name, topic.depth), topic.message)
            for name, topic in TOPICS.items()
            if (kind := _message_class(topic.type))
        ]

    def listen(self, bird: int, topic: str) -> None:
        """Subscribe to the wing of `bird`, too."""

        def hear(data: bytes) -> None:
            self.view.hear_wing(bird, data)

        super().listen(bird, topic)
        self.create_subscription(BirdWing, topics.wing_topic(bird), hear, latched(DEPTH), raw=True)

    def knows(self, sample: Sample) -> bool:
        """Whether discovery is complete, with the wings of all birds."""
        return super().knows(sample) and self.shows

    @property
    def tells_flown(self) -> bool:
        """Whether a clock has given the configuration."""
        return self.view.flown is not None

    @property
    def shows(self) -> bool:
        """Whether all of a step is known, the wings included."""
        return self._snapshot() is not None

    @np.errstate(over="ignore", invalid="ignore")  # of a bird that diverges
    def publish(self) -> None:
        """Send the latest complete step to all listeners."""
        frame = self._framed()
        if frame is None:
            return
        for outlet, message in self._outlets:
            if outlet.get_subscription_count():
                outlet.publish(message(frame))
        for bird in frame.birds:
            outlet = self._outlet_of(bird)
            if outlet.get_subscription_count():
                outlet.publish(frame.odometry(bird))
        if self._foxglove:
            self._foxglove.tell_time(frame.stamp)
            for name in FOXGLOVE_TYPES:
                self._foxglove.publish(name, frame.stamp, partial(TOPICS[name].message, frame))

    def _outlet_of(self, bird: int) -> Publisher:
        """Return the publisher of the Odometry of a bird, which is created at the first call."""
        if bird not in self._birds:
            name = odometry_topic(bird)
            self._birds[bird] = self.create_publisher(self._odometry_type, name, ODOMETRY_DEPTH)
        return self._birds[bird]

    def _framed(self) -> Frame | None:
        """Return the latest complete step, also if it is unchanged; None if there is none."""
        row = self.view.row(self.birds, self._member)
        before = self._frame
        flown = self.view.flown or self._assumed
        if before and row and row[0] is self._shown and before.snapshot.configuration is flown:
            if before.anew:  # markers are removed only once
                self._frame = self._frame_of(before.snapshot, before.trail, anew=False)
            return self._frame
        snapshot = self._snapshot()
        if snapshot is None:
            return None
        gone_back = self._shown is not None and row[0].step <= self._shown.step
        source = self.view.source
        other = before is not None and len(before.snapshot.state.position) != len(row)
        if before is None or gone_back or other or source != self._source:
            self._trail.clear()
        else:
            self._trail.append(before.snapshot.along)
        anew = before is None or before.snapshot.known.tolist() != snapshot.known.tolist()
        self._shown, self._source = row[0], source
        self._frame = self._frame_of(snapshot, list(self._trail), anew)
        return self._frame

    def _frame_of(self, snapshot: Snapshot, trail: Sequence[FloatArray], anew: bool) -> Frame:
        return Frame(snapshot, trail, anew, self._odometry_type is not None)

    def _snapshot(self) -> Snapshot | None:
        """Return the latest complete step; None while a bird or a wing is missing."""
        row = self.view.row(self.birds, self._member)
        flown = self.view.flown
        ratios = flown.span_ratio if flown else self.view.span_ratio(row)
        if not row or ratios is None:
            return None
        state, stamp = FlockState.of(row), (row[0].seconds, row[0].nanoseconds)
        return Snapshot.of(flown or self._assumed, state, ratios, self._member - 1, stamp)


def _message_class(name: str) -> Any:
    """Return the class of the messages of a type; None for tf2_msgs where it is not installed.

    Raises FlockError for nav_msgs, which only --odometry needs, where it is not installed.
    """
    package, _, kind = name.split("/")
    try:
        return getattr(import_module(f"{package}.msg"), kind)
    except ImportError:
        if name == TRANSFORMS:  # it has no wheel
            return None
        if name == ODOMETRY:
            raise FlockError(
                "--odometry: needs nav_msgs; install it, such as by `sudo apt install "
                "ros-jazzy-nav-msgs`, or leave --odometry out"
            ) from None
        raise
