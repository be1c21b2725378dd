# SPDX-License-Identifier: Apache-2.0
"""The elimination of the birds of a chain, one after the other, at one frequency.

With nearest-neighbour coupling, the equations of `DelayedLinearisation` for disturbances exp(s t)
are, in the speed v_j of bird j, the gaps g_j = x_{j+1} - x_j and an acceleration f_j of the bird,

    base_j v_j + z (b_l g_{j-1} - T_l v_{j-1}) - z (b_r g_j + T_r v_{j+1}) = f_j
    base_j = s + c_j + (b_l + b_r) (1 - z) / s    z = exp(-s tau)    T = push + s surge

where b is the pull, and l and r stand for the neighbours j - 1 and j + 1. Also s g_j =
v_{j+1} - v_j. Birds are eliminated from one end. Those before bird j change its equation to
A_j v_j - z (b_r g_j + T_r v_{j+1}) = F_j, so

    A_j = base_j + z (b_l d_{j-1} - T_l r_{j-1})    P_j = s A_j + z b_r
    g_j = d_j v_{j+1} - F_j / P_j                   d_j = (A_j - z T_r) / P_j
    v_j = r_j v_{j+1} + s F_j / P_j                 r_j = z (b_r + s T_r) / P_j
    F_{j+1} = f_{j+1} + W_j F_j                     W_j = z (b_l + s T_l of bird j + 1) / P_j

No small difference of large numbers occurs, not even at s = 0, where all birds move alike (r = 1).
P_1 ... P_j is the determinant of birds 1..j with bird j + 1 held. For an elimination from the other
end, the birds are in reverse order, and gaps have the opposite sign.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from flock_sim.physics.arrays import FloatArray
from flock_sim.physics.compile import kernel

ComplexArray = npt.NDArray[np.complex128]

# Rows of the constants, shape (8, birds): c, b_l + b_r, and the coefficients for the neighbour that
# is eliminated before the bird, and for the one that is eliminated after it.
DAMPING, ALL_PULL = 0, 1
PULL_BEFORE, PUSH_BEFORE, SURGE_BEFORE = 2, 3, 4
PULL_AFTER, PUSH_AFTER, SURGE_AFTER = 5, 6, 7
CONSTANTS = 8

# Rows of the results, shape (12, birds): base, A, P, d, r and W, each with its derivative by s.
BASE, BASE_SLOPE, OWN, OWN_SLOPE, PIVOT, PIVOT_SLOPE = 0, 1, 2, 3, 4, 5
GAP, GAP_SLOPE, RATIO, RATIO_SLOPE, PASSED, PASSED_SLOPE = 6, 7, 8, 9, 10, 11
RESULTS = 12

SHORT = 1e-2
"""Largest |s tau| at which (1 - z) / s is summed up as a series."""


@kernel
def moved_meanwhile(root: complex, lag: float) -> tuple[complex, complex]:
    """Return (1 - exp(-s tau)) / s, the way of a bird in a lag over its speed, and its slope."""
    z = root * lag
    if abs(z) >= SHORT:
        past = np.exp(-z)
        moved = (1.0 - past) / root
        return moved, (lag * past - moved) / root
    # tau sum (-z)^k / (k + 1)!; the next terms are z^8 / 9! and z^7 / 9!, below rounding.
    value, slope = 0.0j, 0.0j
    power, before = 1.0 + 0.0j, 0.0j
    factorial = 1.0
    for k in range(8):
        factorial *= k + 1.0
        value += power / factorial
        slope -= k * before / factorial
        power, before = -z * power, power
    return lag * value, lag * lag * slope


@kernel
def eliminate(root: complex, lag: float, constants: FloatArray, results: ComplexArray) -> None:
    """Fill `results` (12, birds) of the elimination in order from `constants` (8, birds).

    `root` is s in U_min / b, `lag` is tau in b / U_min. P, d, r and W of the last bird are 0.
    """
    birds = constants.shape[1]
    past = np.exp(-root * lag)
    moved, moved_slope = moved_meanwhile(root, lag)
    d, d_slope, r, r_slope = 0.0j, 0.0j, 0.0j, 0.0j
    for j in range(birds):
        pull, push, surge = (
            constants[PULL_BEFORE, j],
            constants[PUSH_BEFORE, j],
            constants[SURGE_BEFORE, j],
        )
        seen = push + root * surge
        base = root + constants[DAMPING, j] + constants[ALL_PULL, j] * moved
        base_slope = 1.0 + constants[ALL_PULL, j] * moved_slope
        before = pull * d - seen * r
        before_slope = pull * d_slope - surge * r - seen * r_slope
        own = base + past * before
        own_slope = base_slope + past * (before_slope - lag * before)
        results[BASE, j], results[BASE_SLOPE, j] = base, base_slope
        results[OWN, j], results[OWN_SLOPE, j] = own, own_slope
        if j == birds - 1:
            results[PIVOT:, j] = 0.0
            break
        pull, push, surge = (
            constants[PULL_AFTER, j],
            constants[PUSH_AFTER, j],
            constants[SURGE_AFTER, j],
        )
        seen = push + root * surge
        pivot = root * own + past * pull
        pivot_slope = own + root * own_slope - lag * past * pull
        one = 1.0 / pivot
        d = (own - past * seen) * one
        d_slope = (own_slope + past * (lag * seen - surge) - d * pivot_slope) * one
        r = past * (pull + root * seen) * one
        r_slope = (past * (push + 2.0 * root * surge) - r * pivot_slope) * one - lag * r
        results[PIVOT, j], results[PIVOT_SLOPE, j] = pivot, pivot_slope
        results[GAP, j], results[GAP_SLOPE, j] = d, d_slope
        results[RATIO, j], results[RATIO_SLOPE, j] = r, r_slope
        pull, push, surge = (
            constants[PULL_BEFORE, j + 1],
            constants[PUSH_BEFORE, j + 1],
            constants[SURGE_BEFORE, j + 1],
        )
        w = past * (pull + root * (push + root * surge)) * one
        results[PASSED, j] = w
        results[PASSED_SLOPE, j] = (
            past * (push + 2.0 * root * surge) - w * pivot_slope
        ) * one - lag * w


@kernel
def joined(left: ComplexArray, right: ComplexArray, j: int) -> tuple[complex, complex]:
    """Return A of the bird with index j, with the birds on both sides eliminated, and its slope.

    `left` and `right` are the eliminations in order and in reverse order.
    """
    i = left.shape[1] - 1 - j
    return (
        left[OWN, j] + (right[OWN, i] - right[BASE, i]),
        left[OWN_SLOPE, j] + (right[OWN_SLOPE, i] - right[BASE_SLOPE, i]),
    )


@kernel
def fill_moved(roots: ComplexArray, lag: float, values: ComplexArray, slopes: ComplexArray) -> None:
    """Fill `moved_meanwhile` for all `roots`."""
    for k in range(len(roots)):
        values[k], slopes[k] = moved_meanwhile(roots[k], lag)
