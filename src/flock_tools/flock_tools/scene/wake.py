# SPDX-License-Identifier: Apache-2.0
"""The air behind a flock: wakes as ribbons, and a plane across them.

All lengths are in b and velocities in U_min. Position is along the flight, lateral to the right,
height upwards.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi

import numpy as np

from flock_sim.physics.arrays import FloatArray
from flock_sim.physics.formation import VORTEX_FRACTION, middle_position
from flock_sim.physics.upwash import flock_upwash

ALONG = np.array([0.0, 0.04, 0.1, 0.2, 0.4, 0.7, 1.0])
"""Places of the corners of ribbons along the flight, from beginning to end."""

BEGIN = 0.15
"""Distance from the bound vortex to the beginning of a ribbon, off the wing."""

LONGEST = 16.0
"""Length of a ribbon if the plane is further away, or in front of the bird."""

INSIDE = np.array([0.0, 0.35, 0.65, 0.85, 0.96])
"""Places of corners across, on either side of the middle, over the vortex half-span."""

OUTSIDE = np.array([0.25, 0.6, 1.0])
"""Places of corners outside of the vortex, over the extent of the ribbon beyond it."""

PLANE_BEHIND = 2.0
"""Distance from the last bird to the plane behind it."""

PLANE_HEIGHT = 1.5
"""Extent of the plane above and below the wings."""

PLANE_ROWS = 24
"""Usual number of rows of cells; even, so that no cell's middle is on a vortex."""

MOST_COLUMNS = 256
"""Largest number of columns of cells of the usual height; a wider flock has wider cells."""


@dataclass(frozen=True)
class Vortices:
    """The horseshoes of the birds whose state is finite; arrays of shape (birds,)."""

    position: FloatArray
    lateral: FloatArray
    span_ratio: FloatArray
    circulation: FloatArray

    @property
    def half(self) -> FloatArray:
        """The vortex half-spans a."""
        return VORTEX_FRACTION * self.span_ratio

    @property
    def far_downwash(self) -> float:
        """Downward air speed far behind one bird, Gamma / (pi a), as a median over the birds."""
        return float(np.median(self.circulation / (pi * self.half)))

    def upwash(self, point: FloatArray) -> FloatArray:
        """Return the upward air speed, shape (...), at `point`, shape (..., 3)."""
        return flock_upwash(point, self.position, self.lateral, self.half, self.circulation)


def ribbons(vortices: Vortices, end: float) -> tuple[FloatArray, FloatArray]:
    """Return the corners of each bird's ribbon, to the position `end`, and the upward air speed.

    Shapes are (birds, behind, across, 3) and (birds, behind, across); across runs from left to
    right. The ribbon of a bird ends midway to the next vortex. On the outside, it extends as far as
    between two standard birds. If no bird is missing, ribbons lie side by side without a gap.
    """
    half = vortices.half
    between = 0.5 * (np.diff(vortices.lateral) - half[:-1] - half[1:])
    outer = 0.5 * (1.0 - VORTEX_FRACTION)
    # If a bird between two is missing, that would be far.
    beyond = np.minimum(np.concatenate([[outer], between, [outer]]), 2.0 * outer)
    inner = np.concatenate([-INSIDE[:0:-1], INSIDE])
    across = np.concatenate(
        [
            -(half[:, np.newaxis] + beyond[:-1, np.newaxis] * OUTSIDE[::-1]),
            half[:, np.newaxis] * inner,
            half[:, np.newaxis] + beyond[1:, np.newaxis] * OUTSIDE,
        ],
        axis=1,
    )
    point = np.zeros((len(half), len(ALONG), across.shape[1], 3))
    length = vortices.position - end
    length = np.where((length > BEGIN) & (length < LONGEST), length, LONGEST)
    behind = BEGIN + (length[:, np.newaxis] - BEGIN) * ALONG
    point[..., 0] = (vortices.position[:, np.newaxis] - behind)[..., np.newaxis]
    point[..., 1] = (vortices.lateral[:, np.newaxis] + across)[:, np.newaxis]
    return point, vortices.upwash(point)


@dataclass(frozen=True)
class Plane:
    """Cells across the flight. `middle` has shape (rows, columns, 3), from the top left."""

    middle: FloatArray
    upwash: FloatArray
    """Upward air speed in the middle of each cell, shape (rows, columns)."""
    width: float
    height: float
    """Height of a cell; `width` is its width."""

    @property
    def position(self) -> float:
        """Position of the plane along the flight."""
        return float(self.middle[0, 0, 0])


def plane(vortices: Vortices, rows: int = PLANE_ROWS) -> Plane:
    """Return the plane PLANE_BEHIND the last bird, with an even number of `rows`.

    Birds far from the flock do not count: the plane is behind the others.
    """
    position, lateral = vortices.position, vortices.lateral
    extent = float(np.ptp(lateral))
    there = position[np.abs(position - middle_position(position)) <= extent + 3.0]
    left = float((lateral - vortices.span_ratio).min()) - 1.0
    right = float((lateral + vortices.span_ratio).max()) + 1.0
    height = 2.0 * PLANE_HEIGHT / rows
    most = MOST_COLUMNS * rows // PLANE_ROWS
    columns = min(most, int(np.ceil((right - left) / height)))
    width = (right - left) / columns
    middle = np.empty((rows, columns, 3))
    middle[..., 0] = there.min() - PLANE_BEHIND
    middle[..., 1] = left + width * (np.arange(columns) + 0.5)
    middle[..., 2] = (PLANE_HEIGHT - height * (np.arange(rows) + 0.5))[:, np.newaxis]
    return Plane(middle, vortices.upwash(middle), width, height)
