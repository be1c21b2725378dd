# SPDX-License-Identifier: Apache-2.0
"""An independent implementation of the paper's formulas, for the tests of steady states.

It uses nothing of the core. Forces are in units of k, so that e_O, C_D and AR enter only by
s = Gamma_min^2 / (2 pi k). `of` is the library of functions: math, or mpmath's mp for more digits.
"""

import math
from itertools import combinations, pairwise

import numpy as np

A = math.pi / 4.0
"""a_i / b_i: half-length of the bound vortex over the semi-span."""

TIP = A - 1.0
"""s_opt, in b."""

K = 2.0 * 0.025 / 9.0
"""k = 2 C_D / AR of the goose. Eq. (hatk)."""

GAMMA = 4.0 * math.sqrt(0.8 * 0.025 / (math.pi * 9.0))
"""Gamma_min of the goose. Eq. (Gammamin)."""

STRENGTH = GAMMA**2 / (2.0 * math.pi * K)
"""s: the paper's Gamma_min^2 / (2 pi k)."""

H_0 = 0.5 * ((18.5 / 18.0) ** 2 + (18.5 / 18.0) ** -2)
"""(U_0^2 + U_0^-2) / 2 of the goose."""

MASS = 3.8 / (1.225 * 0.75**3)
"""m_0 of the goose."""


def integral(x, y, a, b, of=math):
    """I = I_0 + I_+ + I_-, closed form of Eqs. (I0), (Ipm); x source minus target.

    The four edges in I_0 add up to 0. Each is subtracted from its root, so that I_0 is not 0/0 at
    x = 0.
    """
    y = abs(y)
    edges = ((y + a + b, 1), (y - a - b, 1), (y + a - b, -1), (y - a + b, -1))
    bound = sum(sign * x / (of.sqrt(x * x + u * u) + u) for u, sign in edges)
    trailing = sum(sign * (of.log(u) - of.asinh(x / u)) for u, sign in edges)
    return bound + trailing


def even(y, a, b, of=math):
    """E: the part of I that remains side by side, the logarithms of its edges."""
    return of.log((y + a + b) * (y - a - b) / ((y + a - b) * (y - a + b)))


def across(ratios):
    """y_i from the first bird: neighbours are b_i + b_j + s_opt apart."""
    lateral = [0 * ratios[0]]
    for one, other in pairwise(ratios):
        lateral.append(lateral[-1] + one + other + TIP)
    return lateral


def pairs(birds, coupling):
    """All interacting pairs (i, j), i < j, from 0."""
    return [
        (i, j) for i in range(birds) for j in range(i + 1, birds) if coupling == "all" or j == i + 1
    ]


def surplus(ratio, speed, h_0=H_0):
    """(T_j - D_j) / k. Eq. (scaling)."""
    return 2 * h_0 * ratio**4 - ratio**2 * speed**2 - ratio**4 / speed**2


def drag(x, y, source, target, speeds, strength=STRENGTH, of=math):
    """D_ij / k on a target of span ratio `target`, `speeds` those of source and target. Eq. (Djk2).

    Gamma_i Gamma_j I / (4 pi k) with Gamma_j = lambda_j^2 Gamma_min / U_j.
    """
    gammas = (source * target) ** 2 / (speeds[0] * speeds[1])
    return 0.5 * strength * gammas * integral(x, y, A * source, A * target, of)


def saved(y, one, other, speed, strength=STRENGTH, of=math):
    """C_ij / k = (D_ij + D_ji) / k at a common speed, the same at any streamwise distance."""
    return strength * (one * other) ** 2 / speed**2 * even(y, A * one, A * other, of)


def forces(
    positions,
    speeds,
    ratios,
    coupling="nearest",
    *,
    thrusts=None,
    lag=0,
    h_0=H_0,
    strength=STRENGTH,
    of=math,
):
    """(T_j - D_j - sum_i D_ij) / k of every bird, from Eq. (eom3).

    Birds see each other where they were a `lag` ago, at the same speeds. `thrusts` are T_j / T_0 of
    each bird.
    """
    lateral = across(ratios)
    force = [
        surplus(ratio, speed, h_0 * thrust)
        for ratio, speed, thrust in zip(ratios, speeds, thrusts or [1] * len(ratios))
    ]
    for i, j in pairs(len(ratios), coupling):
        for source, target in ((i, j), (j, i)):
            force[target] -= drag(
                positions[source] - speeds[source] * lag - positions[target],
                lateral[source] - lateral[target],
                ratios[source],
                ratios[target],
                (speeds[source], speeds[target]),
                strength,
                of,
            )
    return force


def positions_of(spacing):
    """Positions from the first bird."""
    return np.concatenate([[0.0], np.cumsum(spacing)])


def pair_of(one, other, speed, of=math):
    """C / k of two neighbours of the goose's kind at a common speed."""
    return saved(one + other + TIP, one, other, speed, of=of)


def steady_speed(ratios, coupling="nearest", thrusts=None):
    """U*, where all forces add up to 0: a u^2 - 2 H_0 b' u + b + c = 0 with u = U^2.

    b' is b with the `thrusts` T_j / T_0 as weights.
    """
    side = across(ratios)
    saving = sum(
        saved(side[j] - side[i], ratios[i], ratios[j], 1.0) for i, j in pairs(len(ratios), coupling)
    )
    squares, fourths = (sum(ratio**power for ratio in ratios) for power in (2, 4))
    weights = thrusts or [1] * len(ratios)
    half = H_0 * sum(weight * ratio**4 for weight, ratio in zip(weights, ratios))
    return math.sqrt((half + math.sqrt(half**2 - squares * (fourths + saving))) / squares)


def shares_of_all_sets(ratios, speed, coupling="all", thrusts=None):
    """The share of every proper set of birds (from 0) in the drag saved between it and the others.

    It is the need of the set, less the drag saved within it, over the drag saved by pairs across.
    """
    birds, side = len(ratios), across(ratios)
    weights = thrusts or [1] * len(ratios)
    needed = [surplus(ratio, speed, H_0 * weight) for ratio, weight in zip(ratios, weights)]
    pair = {
        (i, j): saved(side[j] - side[i], ratios[i], ratios[j], speed)
        for i, j in pairs(birds, coupling)
    }
    found = {}
    for size in range(1, birds):
        for behind in combinations(range(birds), size):
            own = sum(c for (i, j), c in pair.items() if i in behind and j in behind)
            between = sum(c for (i, j), c in pair.items() if (i in behind) != (j in behind))
            found[behind] = (sum(needed[i] for i in behind) - own) / between
    return found


def random_ratios(seed, birds, members, spread):
    """Span ratios 1 + spread times a normal number, shape (birds, members)."""
    return 1.0 + spread * np.random.default_rng(seed).standard_normal((birds, members))
