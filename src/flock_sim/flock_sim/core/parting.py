# SPDX-License-Identifier: Apache-2.0
"""Who flies on with whom where no formation exists."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import lsq_linear

from flock_sim.core.equilibrium import TIE, Equilibrium
from flock_sim.core.flock import Flock
from flock_sim.core.kernel import FloatArray
from flock_sim.core.steady_speed import balances

TOGETHER = 1e-8
"""Difference of speeds, in U_min, below which two birds fly on together."""

ROUNDS = 20
"""How often circulations and slopes are taken again at the speeds that were found."""

MOST = 0.5
"""Largest difference of speeds, relative to U*."""

LEAST_SLOPE = 1e-3
"""Of a bird's drag by its speed, over k: it has next to none at its minimum-drag speed."""


def parts(flock: Flock, equilibrium: Equilibrium, member: int) -> list[list[int]]:
    """Return the birds (from 1) that fly on together, the fastest part first; one part if all do.

    `equilibrium` is that of `flock`, `member` an index. Empty where no speed balances the forces.

    Each pair shares C_ij = D_ij + D_ji between its birds as it likes, the one behind gaining up to
    all of it. The birds use that to stay together; the force F_j that is left gives bird j the
    speed U* + F_j / Q_j, Q_j the mean slope of its drag in between. A pair that flies at one speed
    shares within (0, 1); one that parts has given all it has to the slower. These are the
    conditions of the least of sum_j F_j^2 / Q_j over all shares in [0, 1]: a least-squares problem
    with bounds, solved again with the C_ij and Q_j at the speeds that it gives.
    """
    ratio = flock.span_ratio[:, member]
    common = float(equilibrium.balanced_speed[member])
    if not np.isfinite(common):
        return []
    needed = balances(ratio, common**2, flock.scales.cruise_ratio)
    tail, head = flock.pairs.T
    constant = flock.scales.saving_ratio * (ratio[tail] * ratio[head]) ** 2 * flock.even[:, member]
    pair = np.arange(len(constant))
    over = np.zeros(flock.birds)
    for _ in range(ROUNDS):
        speed = common + over
        saved = constant / (speed[tail] * speed[head])
        weight = 1.0 / np.maximum(_slope(ratio, common, speed), LEAST_SLOPE)
        given = np.zeros((flock.birds, len(pair)))
        given[tail, pair], given[head, pair] = saved, -saved
        left = needed.copy()
        np.subtract.at(left, head, saved)
        root = np.sqrt(weight)
        share = lsq_linear(
            root[:, np.newaxis] * given, root * left, (0.0, 1.0), method="bvls", tol=1e-14
        ).x
        before, over = over, np.clip(weight * (left - given @ share), -MOST * common, MOST * common)
        if np.abs(over - before).max() < 0.01 * TOGETHER:
            break
    return _together(over, flock.coupling == "nearest")


def _slope(ratio: FloatArray, common: float, speed: FloatArray) -> FloatArray:
    """Return (D(speed) - D(common)) / k over the difference of speeds."""
    total = common + speed
    product = (common * speed) ** 2
    slope: FloatArray = ratio**2 * total - ratio**4 * total / product
    return slope


def _together(over: FloatArray, in_line: bool) -> list[list[int]]:
    """Return the birds (from 1) grouped by speed; in_line: only neighbours fly together."""
    order: Sequence[int] = range(len(over)) if in_line else list(np.argsort(over))
    groups = [[int(order[0])]]
    for before, bird in zip(order[:-1], order[1:]):
        if abs(over[bird] - over[before]) > TOGETHER:
            groups.append([])
        groups[-1].append(int(bird))
    groups.sort(key=lambda group: -max(over[i] for i in group))
    return [sorted(i + 1 for i in group) for group in groups]


def opening_gap(equilibrium: Equilibrium, groups: list[list[int]], member: int) -> int:
    """Return the gap (from 1) that opens: of those between parts, the one of least margin.

    `groups` are the parts of the flock with index `member`; 0 where they are one or none.
    """
    share = equilibrium.share[:, member]
    part = {bird: number for number, group in enumerate(groups) for bird in group}
    open_gaps = [i for i in range(1, len(part)) if part[i] != part[i + 1]]
    margin = np.minimum(share, 1.0 - share)
    least = min((margin[i - 1] for i in open_gaps), default=0.0)
    return next((i for i in open_gaps if margin[i - 1] <= least + TIE), 0)
