# SPDX-License-Identifier: Apache-2.0
"""The groups of birds that continue to fly together if no formation exists."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cmp_to_key

import numpy as np

from flock_sim.physics.arrays import FloatArray, IntArray
from flock_sim.physics.flock import Flock
from flock_sim.theory.equilibrium import TIE, Equilibrium, distance_from_end
from flock_sim.theory.steady_speed import balances

TOGETHER = 1e-11
"""Largest difference of speeds, in U_min, that is rounding: such birds fly on together."""

SETTLED = 1e-10
"""Change of speeds, in U_min, below which the iteration ends."""

ROUNDS = 20
"""Most iterations; each computes circulations and slopes at the last speeds."""

MOST = 0.5
"""Largest difference of a speed from U*, relative to U*."""

LEAST_SLOPE = 1e-3
"""Least slope of a bird's drag by its speed, over k: at minimum-drag speed it is almost 0."""


def parts(flock: Flock, equilibrium: Equilibrium, member: int) -> list[list[int]]:
    """Return the groups of birds (from 1) that fly on together, the fastest group first.

    `equilibrium` is that of `flock`, `member` an index. The result is one group if a formation
    exists, and empty if no speed balances the forces.

    Each pair can share C_ij = D_ij + D_ji between its birds in any ratio; the bird behind can gain
    up to all of it. The shares keep birds together as far as possible. The force F_j that is left
    gives bird j the speed U* + F_j / Q_j, where Q_j is the mean slope of its drag between U* and
    this speed. A pair at one speed has a share within (0, 1); a pair that parts has given all of
    C_ij to the slower bird. These are the conditions for the minimum of sum_j F_j^2 / Q_j over all
    shares in [0, 1]. The minimum is computed repeatedly, with C_ij and Q_j at the last speeds.
    Speeds that differ from U* by more than MOST are limited: birds that are as slow as this have no
    steady speed of their own.
    """
    birds = range(1, flock.birds + 1)
    if equilibrium.exists[member]:
        return [list(birds)]
    ratio = flock.span_ratio[:, member]
    common = float(equilibrium.balanced_speed[member])
    if not np.isfinite(common):
        return []
    cruise_ratio = flock.scales.cruise_ratio * equilibrium.thrust_ratio[:, member]
    needed = balances(ratio, common**2, cruise_ratio)
    tail, head = flock.pairs.T
    constant = flock.scales.saving_ratio * (ratio[tail] * ratio[head]) ** 2 * flock.even[:, member]
    least = _taut_string if flock.coupling == "nearest" else _least_squares
    over = np.zeros(flock.birds)
    for _ in range(ROUNDS):
        speed = common + over
        saved = constant / (speed[tail] * speed[head])
        slope = np.maximum(_slope(ratio, common, speed), LEAST_SLOPE)
        found = least(flock.pairs, needed, saved, slope)
        before, over = over, np.clip(found, -MOST * common, MOST * common)
        if np.abs(over - before).max() < SETTLED:
            break
    groups = _together(found, flock.coupling == "nearest")
    if len(groups) == 1:
        # So close to a limit that the speeds differ by rounding only.
        behind = equilibrium.worst_set[:, member]
        groups = [[bird for bird in birds if behind[bird - 1] == last] for last in (False, True)]
    return groups


def _least_squares(
    pairs: IntArray, needed: FloatArray, saved: FloatArray, slope: FloatArray
) -> FloatArray:
    """Return F_j / Q_j, shape (birds,), by least squares with bounds, for any pairs.

    `needed` R_j and `slope` Q_j have shape (birds,), `saved` C_ij (pairs,), all over k.
    """
    from scipy.optimize import lsq_linear

    tail, head = pairs.T
    pair = np.arange(len(saved))
    given = np.zeros((len(needed), len(saved)))
    given[tail, pair], given[head, pair] = saved, -saved
    left = needed.copy()
    np.subtract.at(left, head, saved)
    root = np.sqrt(slope)
    share = lsq_linear(
        given / root[:, np.newaxis], left / root, (0.0, 1.0), method="bvls", tol=1e-14
    ).x
    over: FloatArray = (left - given @ share) / slope
    return over


def _taut_string(
    pairs: IntArray, needed: FloatArray, saved: FloatArray, slope: FloatArray
) -> FloatArray:
    """Return the same as `_least_squares`, but fast and only for birds in a chain.

    Y_j is the sum of the forces left on birds 1..j. It may lie anywhere between low_j and
    low_j - C_j, depending on the share of gap j; Y_0 and Y_N are fixed. Plotted against the sum of
    the slopes, the minimum of sum_j (Y_j - Y_{j-1})^2 / Q_j is a taut string through these gates.
    Its slopes are the speeds; it bends where birds part.
    """
    across = np.concatenate([[0.0], np.cumsum(slope)])
    low = np.concatenate([[0.0], np.cumsum(needed - np.concatenate([[0.0], saved]))])
    high = low - np.concatenate([[0.0], saved, [0.0]])
    over = np.empty_like(needed)
    at, height = 0, 0.0
    while at < len(needed):
        least, most, last_low, last_high = -np.inf, np.inf, at, at
        for gate in range(at + 1, len(low)):
            reach = across[gate] - across[at]
            from_low, from_high = (low[gate] - height) / reach, (high[gate] - height) / reach
            if from_low > most or from_high < least:
                break
            if from_low >= least:
                least, last_low = from_low, gate
            if from_high <= most:
                most, last_high = from_high, gate
        if from_low > most:
            corner, steepness, height = last_high, most, high[last_high]
        elif from_high < least:
            corner, steepness, height = last_low, least, low[last_low]
        else:
            corner, steepness = len(needed), from_low
        over[at:corner] = steepness
        at = corner
    return over


def _slope(ratio: FloatArray, common: float, speed: FloatArray) -> FloatArray:
    """Return (D(speed) - D(common)) / k divided by speed - common."""
    total = common + speed
    product = (common * speed) ** 2
    slope: FloatArray = ratio**2 * total - ratio**4 * total / product
    return slope


def _together(over: FloatArray, in_line: bool) -> list[list[int]]:
    """Return the birds (from 1) grouped by speed; `in_line`: only neighbours can fly together."""
    order: Sequence[int] = range(len(over)) if in_line else list(np.argsort(over))
    groups = [[int(order[0])]]
    for before, bird in zip(order[:-1], order[1:]):
        if abs(over[bird] - over[before]) > TOGETHER:
            groups.append([])
        groups[-1].append(int(bird))
    speed = {min(group): float(over[group].max()) for group in groups}

    def compare(one: list[int], other: list[int]) -> int:
        """Order groups by falling speed; of mirror images, which have one speed, left first."""
        difference = speed[min(other)] - speed[min(one)]
        if abs(difference) > TOGETHER:
            return 1 if difference > 0.0 else -1
        return min(one) - min(other)

    groups.sort(key=cmp_to_key(compare))
    return [sorted(i + 1 for i in group) for group in groups]


def opening_gap(equilibrium: Equilibrium, groups: list[list[int]], member: int) -> int:
    """Return the gap (from 1) that opens: of the gaps between parts, the one of least margin.

    `groups` are the `parts` of the flock with index `member`; 0 for fewer than two groups.
    """
    share = equilibrium.share[:, member]
    part = {bird: number for number, group in enumerate(groups) for bird in group}
    open_gaps = [i for i in range(1, len(part)) if part[i] != part[i + 1]]
    margin = distance_from_end(share)
    least = min((margin[i - 1] for i in open_gaps), default=0.0)
    return next((i for i in open_gaps if margin[i - 1] <= least + TIE), 0)
