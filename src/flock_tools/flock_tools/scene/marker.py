# SPDX-License-Identifier: Apache-2.0
"""One coloured shape of a scene, as RViz and Foxglove know it.

The frame of the shapes moves with the flock. Its origin is that of the snapshot, usually the
leader's wing. In m, x is forward, y left and z up.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np
from matplotlib.colors import LinearSegmentedColormap

from flock_sim.physics.arrays import FloatArray

INK = (0.1, 0.48, 0.9, 1.0)
"""Colour of text and trails. Its contrast is at least 3 : 1 on the backgrounds of all viewers, from
white to black, and 4 : 1 on the white plates that Foxglove and Lichtblick put behind texts."""

UPWASH = LinearSegmentedColormap.from_list(
    "upwash", ["#f1f2fb", "#d0d1d6", "#adadad", "#b9604f", "#6b0a18"]
)
"""Sinking air is pale. Rising air, which saves drag, is red. The faster it rises, the darker it is,
so the two differ in a grey print, too. No bird has these colours."""


class Kind(IntEnum):
    """The kind of a shape, with the numbers of visualization_msgs/Marker."""

    LINE = 4
    CUBES = 6
    TEXT = 9
    TRIANGLES = 11


@dataclass(frozen=True)
class Shape:
    """One marker. `points` and `colours` have shape (points, 3) and (points, 4).

    A text has no points and one colour; triangles have three points each.
    """

    group: str
    number: int
    kind: Kind
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    scale: tuple[float, float, float] = (1.0, 1.0, 1.0)
    points: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))
    colours: FloatArray = field(default_factory=lambda: np.array([INK]))
    text: str = ""


def in_metres(point: FloatArray, metre: float) -> FloatArray:
    """Return points given by position, lateral and height in b as x, y and z in m."""
    return np.asarray(metre * point * (1.0, -1.0, 1.0))
