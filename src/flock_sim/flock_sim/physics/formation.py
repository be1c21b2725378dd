# SPDX-License-Identifier: Apache-2.0
"""The layout of a flock: its leader, its interacting birds, and their start positions.

Birds are numbered 1..N from the tail of the left wing; lateral distances are in b.
"""

from collections.abc import Iterator
from math import pi

import numpy as np

from flock_sim.physics.arrays import FloatArray

VORTEX_FRACTION = pi / 4.0
"""a_i / b_i: half-length of the bound vortex over the semi-span."""

TIP_SPACING = pi / 4.0 - 1.0
"""s_opt, in b. It is negative: wing tips overlap."""

START_SLOPE = 1.0
"""tan(theta) of the V in which a flight starts, theta = 45 degrees: lateral over streamwise."""


def leader(birds: int) -> int:
    """Return the number of the leader of a flock: N // 2 + 1."""
    return birds // 2 + 1


def neighbours(bird: int, birds: int, coupling: str) -> tuple[int, ...]:
    """Return the birds that `bird` feels, ascending: drags are summed in this order."""
    if coupling == "all":
        return tuple(other for other in range(1, birds + 1) if other != bird)
    return tuple(other for other in (bird - 1, bird + 1) if 1 <= other <= birds)


def pairs(birds: int, coupling: str) -> Iterator[tuple[int, int]]:
    """Yield the interacting pairs (i, j), i < j, in ascending order."""
    for bird in range(1, birds + 1):
        for other in neighbours(bird, birds, coupling):
            if other > bird:
                yield bird, other


def lateral_distance(span_ratio: FloatArray) -> FloatArray:
    """Return the lateral distance of the first and last of a row of adjacent birds, in b.

    `span_ratio` has shape (row, members), the result (members,). Neighbours are b_i + b_j + s_opt
    apart. The terms are added from tail to head, so that every process that knows the same birds
    gets the same bits.
    """
    distance = np.zeros(span_ratio.shape[1])
    for tail, head in zip(span_ratio[:-1], span_ratio[1:], strict=True):
        distance = distance + (tail + head + TIP_SPACING)
    return distance


def lateral_positions(span_ratio: FloatArray) -> FloatArray:
    """Return y_i relative to the leader, shape (birds, members) as `span_ratio`, in b."""
    birds = span_ratio.shape[0]
    head = leader(birds) - 1
    lateral = np.zeros_like(span_ratio)
    for bird in range(head):
        lateral[bird] = -lateral_distance(span_ratio[bird : head + 1])
    for bird in range(head + 1, birds):
        lateral[bird] = lateral_distance(span_ratio[head : bird + 1])
    return lateral


def positions(spacing: FloatArray) -> FloatArray:
    """Return x_i from bird 1, shape (birds, members), of `spacing` (birds - 1, members), in b."""
    position = np.zeros((spacing.shape[0] + 1, spacing.shape[1]))
    np.cumsum(spacing, axis=0, out=position[1:])
    return position


def positions_by_gaps(birds: int) -> FloatArray:
    """Return the matrix of `positions`, (birds, birds - 1): a gap moves all birds after it."""
    return np.tril(np.ones((birds, birds)), -1)[:, : birds - 1]


def middle_position(position: FloatArray) -> float:
    """Return the position of the bird in the middle of `position`, shape (birds,), one or more.

    For an even number of birds it is the upper one of the middle two. Their mean can be far from
    every bird if a flock has parted in halves.
    """
    return float(sorted(position.tolist())[len(position) // 2])


def start_position(bird: int, birds: int) -> float:
    """Return x_i(0) of the start in a V, in b: -|i - n| dy_0 / tan(theta), with the leader at 0.

    The V is that of standard birds, dy_0 = 2 b + s_opt, whatever the span ratios.
    """
    return -abs(bird - leader(birds)) * (2.0 + TIP_SPACING) / START_SLOPE
