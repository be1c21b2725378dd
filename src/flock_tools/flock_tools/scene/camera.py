# SPDX-License-Identifier: Apache-2.0
"""The camera of a picture of a scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from flock_sim.physics.arrays import FloatArray
from flock_tools.scene.marker import Shape

ELEVATION, AZIMUTH = 30.0, 15.0
"""Direction of view, in degrees: from in front of the flock, above and a little to its left."""

DISTANCE = 1.6
"""Distance of the camera from the middle of the scene, over the scene's diagonal."""

MARGIN = 0.03
"""Margin beside the scene, over its width."""


@dataclass(frozen=True)
class Camera:
    """The position and direction of the camera, and the part of its view in the picture."""

    place: FloatArray
    axes: FloatArray
    """Unit vectors to the right, up, and into the scene, shape (3, 3)."""
    distance: float
    """Distance from the middle of the scene, in m."""
    low: FloatArray
    width: float
    height: float
    """Height of the picture, over its width."""

    @classmethod
    def at(cls, shapes: Sequence[Shape], points: FloatArray | None = None) -> Self:
        """Return the camera that sees all of `shapes`, and of `points`, shape (points, 3)."""
        more = [] if points is None else [points]
        seen_points = np.concatenate([*(shape.points + shape.origin for shape in shapes), *more])
        low, high = seen_points.min(axis=0), seen_points.max(axis=0)
        azimuth, elevation = np.radians(AZIMUTH), np.radians(ELEVATION)
        into = -np.array(
            [
                np.cos(elevation) * np.cos(azimuth),
                np.cos(elevation) * np.sin(azimuth),
                np.sin(elevation),
            ]
        )
        right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
        axes = np.stack([right, np.cross(right, into), into])
        distance = DISTANCE * float(np.linalg.norm(high - low))
        place = 0.5 * (low + high) - distance * into
        unframed = cls(place, axes, distance, np.zeros(2), 1.0, 1.0)
        seen, _ = unframed.see(seen_points)
        least, extent = seen.min(axis=0), np.ptp(seen, axis=0)
        margin = MARGIN * extent[0]
        width = extent[0] + 2.0 * margin
        height = (extent[1] + 3.0 * margin) / width
        return cls(place, axes, distance, least - margin, width, height)

    @property
    def scope(self) -> float:
        """Width of the picture in the middle of the scene, in m."""
        return self.width * self.distance

    def see(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the places of points (..., 3) on the picture, (..., 2), and their distances."""
        seen = (points - self.place) @ self.axes.T
        return (seen[..., :2] / seen[..., 2:] - self.low) / self.width, seen[..., 2]
