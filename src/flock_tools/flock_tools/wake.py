# SPDX-License-Identifier: Apache-2.0
"""The air behind a flock: wakes as ribbons, and a plane across them.

All lengths are in b and velocities in U_min: position is counted along the flight, lateral to the
right and height upwards.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi

import numpy as np

from flock_sim.core.formation import VORTEX_FRACTION
from flock_sim.core.kernel import FloatArray
from flock_sim.core.upwash import flock_upwash

ALONG = np.array([0.0, 0.04, 0.1, 0.2, 0.4, 0.7, 1.0])
"""Where the ribbons have corners, from beginning to end."""

BEGIN = 0.15
"""Where they begin, behind the bound vortex: off the wing."""

LONGEST = 16.0
"""How far behind a bird its ribbon ends, where the plane is further away, or in front of it."""

INSIDE = np.array([0.0, 0.35, 0.65, 0.85, 0.96])
"""Where they have corners across, on either side of the middle, over the vortex half-span."""

OUTSIDE = np.array([0.25, 0.6, 1.0])
"""Where they have corners outside of the vortex, over how far they reach beyond it."""

PLANE_BEHIND = 2.0
"""How far behind the last bird the plane is."""

PLANE_HEIGHT = 1.5
"""How far the plane reaches above and below the wings."""

PLANE_ROWS = 24
"""Of cells; even, so that no cell's middle is on a vortex."""

MOST_COLUMNS = 256
"""Of cells; a wider flock has wider ones."""


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
        """How fast air goes down far behind one bird, as most are: Gamma / (pi a)."""
        return float(np.median(self.circulation / (pi * self.half)))

    def upwash(self, point: FloatArray) -> FloatArray:
        """Return how fast the air rises at `point`, shape (..., 3); shape (...)."""
        return flock_upwash(point, self.position, self.lateral, self.half, self.circulation)


def ribbons(vortices: Vortices, end: float) -> tuple[FloatArray, FloatArray]:
    """Return the corners of each bird's ribbon, to the position `end`, and how fast the air rises.

    Shapes (birds, behind, across, 3) and (birds, behind, across); across runs from left to right.
    The ribbon of a bird ends midway to the next vortex; on the outside as far as it would between
    two standard birds. Where birds are all there, ribbons lie side by side without a gap.
    """
    half = vortices.half
    between = 0.5 * (np.diff(vortices.lateral) - half[:-1] - half[1:])
    outer = 0.5 * (1.0 - VORTEX_FRACTION)
    # Where a bird between two is not there, that would be far.
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
    """Cells across the flight; `middle` has shape (rows, columns, 3), from the top left on."""

    middle: FloatArray
    upwash: FloatArray
    """How fast the air rises in the middle of each cell, shape (rows, columns)."""
    width: float
    height: float
    """Of a cell."""

    @property
    def position(self) -> float:
        """Where it is, along the flight."""
        return float(self.middle[0, 0, 0])


def plane(vortices: Vortices) -> Plane:
    """Return the plane PLANE_BEHIND the last bird.

    Birds that the flock has left behind for good do not count: the plane is behind the others.
    """
    position, lateral = vortices.position, vortices.lateral
    extent = float(np.ptp(lateral))
    there = position[np.abs(position - np.median(position)) <= extent + 3.0]
    left = float((lateral - vortices.span_ratio).min()) - 1.0
    right = float((lateral + vortices.span_ratio).max()) + 1.0
    height = 2.0 * PLANE_HEIGHT / PLANE_ROWS
    columns = min(MOST_COLUMNS, int(np.ceil((right - left) / height)))
    width = (right - left) / columns
    middle = np.empty((PLANE_ROWS, columns, 3))
    middle[..., 0] = there.min() - PLANE_BEHIND
    middle[..., 1] = left + width * (np.arange(columns) + 0.5)
    middle[..., 2] = (PLANE_HEIGHT - height * (np.arange(PLANE_ROWS) + 0.5))[:, np.newaxis]
    return Plane(middle, vortices.upwash(middle), width, height)
