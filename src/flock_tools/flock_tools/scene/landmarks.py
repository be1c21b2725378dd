# SPDX-License-Identifier: Apache-2.0
"""A bar of known length and an arrow along the flight, ahead of the birds of a scene, in m."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from flock_sim.physics.arrays import FloatArray

PART, LEAST = 0.2, 1.5
"""Largest length of the bar, over the extent of the birds across the flight; but at least LEAST b.
"""

AHEAD = 1.0
"""Distance of the bar from the first bird, over the semi-span of a standard bird."""

HEAD, FLARE = 0.3, 0.08
"""Length and half width of the arrow's head, over the length of the arrow."""


@dataclass(frozen=True)
class Landmarks:
    """Points have x forward, y to the left and z up."""

    length: float
    """Length of the bar, in m: 1, 2 or 5 times a power of ten."""
    bar: FloatArray
    """The ends of the bar, shape (2, 3)."""
    arrow: FloatArray
    """The beginning of the arrow, in the middle of the bar, and its end, shape (2, 3)."""

    @classmethod
    def ahead_of(cls, place: FloatArray, metre: float) -> Self:
        """Return the landmarks of birds at `place`, shape (birds, 3); `metre` is b in m."""
        left, right = place[:, 1].max() + metre, place[:, 1].min() - metre
        length = round_length(max(PART * float(left - right), LEAST * metre))
        middle = np.array([place[:, 0].max() + AHEAD * metre, 0.5 * (left + right), 0.0])
        aside, forward = np.array([[0.0, 0.5, 0.0], [1.0, 0.0, 0.0]]) * length
        return cls(
            length, np.array([middle - aside, middle + aside]), middle + [[0, 0, 0], forward]
        )

    @property
    def head(self) -> FloatArray:
        """The corners of the arrow's head, shape (3, 3)."""
        end = self.arrow[1]
        back = HEAD * (self.arrow[0] - end)
        aside = FLARE * (self.bar[1] - self.bar[0])
        return np.array([end + back + aside, end, end + back - aside])

    @property
    def points(self) -> FloatArray:
        """All points, shape (points, 3)."""
        return np.concatenate([self.bar, self.arrow])


def round_length(most: float) -> float:
    """Return the largest of 1, 2 and 5 times a power of ten that is at most `most`, above 0."""
    power = 10.0 ** np.floor(np.log10(most))
    return float(power * max(factor for factor in (1.0, 2.0, 5.0) if factor * power <= most))
