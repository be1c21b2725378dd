# SPDX-License-Identifier: Apache-2.0
"""The topics of `view`, and a snapshot as the messages on them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import NamedTuple

from flock_sim.messages import topics
from flock_sim.messages.types import BILLION
from flock_sim.physics.arrays import FloatArray
from flock_tools.scene import messages
from flock_tools.scene.shapes import Scene, scene
from flock_tools.scene.snapshot import Snapshot
from flock_tools.scene.upwash_image import upwash_image

MARKERS_TOPIC = f"{topics.NAMESPACE}/view/markers"
UPWASH_TOPIC = f"{topics.NAMESPACE}/view/upwash"
COLOR_TOPIC = f"{topics.NAMESPACE}/view/upwash_color"
TRANSFORM_TOPIC = f"{topics.NAMESPACE}/view/transform"
TF_TOPIC = "/tf"

ODOMETRY_DEPTH = 10
"""Depth of the queues of Odometry."""

TRAIL = 600
"""Largest number of points of a trail."""


class Frame:
    """A snapshot as serialised messages. Each is created when it is first used."""

    def __init__(
        self,
        snapshot: Snapshot,
        trail: Sequence[FloatArray],
        anew: bool,
        odometry: bool = False,
    ) -> None:
        """Store the snapshot. With `anew`, the markers first remove all earlier ones.

        With `odometry`, each bird has a frame on /tf, and an Odometry.
        """
        self.snapshot = snapshot
        self.birds = snapshot.finite_birds if odometry else []
        """Numbers of the birds that have an Odometry; a bird that has diverged has none."""
        self.trail = trail
        self.anew = anew

    @property
    def stamp(self) -> int:
        """Simulated time, in ns."""
        seconds, nanoseconds = self.snapshot.stamp
        return seconds * BILLION + nanoseconds

    @cached_property
    def scene(self) -> Scene:
        """The scene of the snapshot."""
        return scene(self.snapshot, self.trail)

    @cached_property
    def markers(self) -> bytes:
        """A MarkerArray."""
        return messages.markers(self.scene, self.anew)

    @cached_property
    def upwash(self) -> bytes:
        """An Image of numbers."""
        return messages.image(self.snapshot, self.scene.upwash, messages.NUMBERS)

    @cached_property
    def upwash_color(self) -> bytes:
        """An Image of colours."""
        return messages.image(self.snapshot, upwash_image(self.scene), messages.COLORS)

    @cached_property
    def transform(self) -> bytes:
        """A TransformStamped."""
        return messages.transform(self.snapshot)

    @cached_property
    def transforms(self) -> bytes:
        """A TFMessage."""
        return messages.transforms(self.snapshot, self.birds)

    def odometry(self, bird: int) -> bytes:
        """Return the Odometry of one of `birds`."""
        return messages.odometry(self.snapshot, bird)


class SceneTopic(NamedTuple):
    """The type of a topic, its message, and the depth of its queues."""

    type: str
    message: Callable[[Frame], bytes]
    depth: int = 1


TOPICS = {
    MARKERS_TOPIC: SceneTopic(messages.MARKERS, lambda frame: frame.markers),
    UPWASH_TOPIC: SceneTopic(messages.IMAGE, lambda frame: frame.upwash),
    COLOR_TOPIC: SceneTopic(messages.IMAGE, lambda frame: frame.upwash_color),
    TRANSFORM_TOPIC: SceneTopic(messages.TRANSFORM, lambda frame: frame.transform),
    TF_TOPIC: SceneTopic(messages.TRANSFORMS, lambda frame: frame.transforms, 100),
}
"""The topics of a scene by name."""


def odometry_topic(bird: int) -> str:
    """Return the topic of the Odometry of a bird, relative to the namespace of the flock."""
    return f"{topics.bird_name(bird)}/odometry"
