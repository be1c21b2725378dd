# SPDX-License-Identifier: Apache-2.0
"""Responses of a chain of birds at many frequencies; each takes a time proportional to its length.

All kernels take the values s = i omega, `roots`, the lag, the `constants` of `elimination` and
those of the `reverse` order, and fill arrays whose first axis is that of `roots`. Symbols are those
of `elimination`.
"""

from __future__ import annotations

import numpy as np

from flock_sim.physics.arrays import FloatArray
from flock_sim.physics.compile import kernel
from flock_sim.response.elimination import (
    GAP,
    GAP_SLOPE,
    PASSED,
    PIVOT,
    PIVOT_SLOPE,
    RATIO,
    RATIO_SLOPE,
    RESULTS,
    ComplexArray,
    eliminate,
    joined,
)


@kernel
def fill_logarithms(
    roots: ComplexArray,
    lag: float,
    constants: FloatArray,
    reverse: FloatArray,
    leader: int,
    scale: float,
    logarithms: ComplexArray,
    slopes: ComplexArray,
) -> None:
    """Fill the logarithms of the factors of the determinant, and their derivatives by s.

    Both have shape (roots, birds). The factor of the bird with index `leader` is its A with both
    wings eliminated, divided by s + `scale`; that of another bird is P / (s + `scale`)^2.
    """
    birds = constants.shape[1]
    left = np.empty((RESULTS, birds), dtype=np.complex128)
    right = np.empty((RESULTS, birds), dtype=np.complex128)
    for k in range(len(roots)):
        eliminate(roots[k], lag, constants, left)
        eliminate(roots[k], lag, reverse, right)
        shifted = roots[k] + scale
        for j in range(birds):
            if j == leader:
                factor, slope = joined(left, right, j)
                logarithms[k, j] = np.log(factor / shifted)
                slopes[k, j] = slope / factor - 1.0 / shifted
            else:
                side = left if j < leader else right
                i = j if j < leader else birds - 1 - j
                logarithms[k, j] = np.log(side[PIVOT, i] / (shifted * shifted))
                slopes[k, j] = side[PIVOT_SLOPE, i] / side[PIVOT, i] - 2.0 / shifted


@kernel
def fill_followings(
    roots: ComplexArray,
    lag: float,
    constants: FloatArray,
    reverse: FloatArray,
    leader: int,
    gains: FloatArray,
    slopes: FloatArray,
) -> None:
    """Fill log |v_j / v_leader| with the leader's speed prescribed, and its derivative by omega.

    Both have shape (roots, birds).
    """
    birds = constants.shape[1]
    results = np.empty((RESULTS, birds), dtype=np.complex128)
    for k in range(len(roots)):
        gains[k, leader], slopes[k, leader] = 0.0, 0.0
        for side in range(2):
            eliminate(roots[k], lag, constants if side == 0 else reverse, results)
            head = leader if side == 0 else birds - 1 - leader
            gain, slope = 0.0, 0.0
            for i in range(head - 1, -1, -1):
                j = i if side == 0 else birds - 1 - i
                gain += np.log(abs(results[RATIO, i]))
                slope -= (results[RATIO_SLOPE, i] / results[RATIO, i]).imag
                gains[k, j], slopes[k, j] = gain, slope


@kernel
def fill_from_leader(
    roots: ComplexArray,
    lag: float,
    constants: FloatArray,
    reverse: FloatArray,
    leader: int,
    gains: FloatArray,
    slopes: FloatArray,
) -> None:
    """Fill the logarithm of the norm of all gaps per acceleration of the leader, and its slope.

    Both have shape (roots,); the slope is the derivative by omega. Two birds or more.
    """
    birds = constants.shape[1]
    left = np.empty((RESULTS, birds), dtype=np.complex128)
    right = np.empty((RESULTS, birds), dtype=np.complex128)
    for k in range(len(roots)):
        eliminate(roots[k], lag, constants, left)
        eliminate(roots[k], lag, reverse, right)
        own, own_slope = joined(left, right, leader)
        total, weighted = 0.0, 0.0
        for side in range(2):
            results = left if side == 0 else right
            head = leader if side == 0 else birds - 1 - leader
            gain, slope = -np.log(abs(own)), (own_slope / own).imag
            for i in range(head - 1, -1, -1):
                square = np.exp(2.0 * gain) * abs(results[GAP, i]) ** 2
                total += square
                weighted += square * (slope - (results[GAP_SLOPE, i] / results[GAP, i]).imag)
                gain += np.log(abs(results[RATIO, i]))
                slope -= (results[RATIO_SLOPE, i] / results[RATIO, i]).imag
        gains[k] = 0.5 * np.log(total)
        slopes[k] = weighted / total


@kernel
def fill_densities(
    roots: ComplexArray,
    lag: float,
    constants: FloatArray,
    reverse: FloatArray,
    densities: FloatArray,
) -> None:
    """Fill the squared responses to unit accelerations of single birds, summed over these birds.

    `densities` has shape (roots, 2 birds): the birds - 1 gaps, the speeds, and the mean speed.
    """
    birds = constants.shape[1]
    left = np.empty((RESULTS, birds), dtype=np.complex128)
    right = np.empty((RESULTS, birds), dtype=np.complex128)
    # Squared forces that birds before and after a bird pass on to it, and sums of their speeds.
    behind, ahead = np.empty(birds), np.empty(birds)
    moved_behind = np.empty(birds, dtype=np.complex128)
    moved_ahead = np.empty(birds, dtype=np.complex128)
    for k in range(len(roots)):
        eliminate(roots[k], lag, constants, left)
        eliminate(roots[k], lag, reverse, right)
        for side in range(2):
            results = left if side == 0 else right
            force, moved = 0.0, 0.0j
            for i in range(birds):
                j = i if side == 0 else birds - 1 - i
                if side == 0:
                    behind[j], moved_behind[j] = force, moved
                else:
                    ahead[j], moved_ahead[j] = force, moved
                force = abs(results[PASSED, i]) ** 2 * (1.0 + force)
                moved = results[RATIO, i] * (1.0 + moved)
        mean = 0.0
        for j in range(birds):
            own = 1.0 / abs(joined(left, right, j)[0]) ** 2
            densities[k, birds - 1 + j] = own * (1.0 + behind[j] + ahead[j])
            mean += own * abs(1.0 + moved_behind[j] + moved_ahead[j]) ** 2
            if j < birds - 1:
                # Birds up to j move bird j, and thereby the gap; birds after j move bird j + 1.
                i = birds - 2 - j
                other = 1.0 / abs(joined(left, right, j + 1)[0]) ** 2
                densities[k, j] = abs(right[GAP, i]) ** 2 * own * (1.0 + behind[j])
                densities[k, j] += abs(left[GAP, j]) ** 2 * other * (1.0 + ahead[j + 1])
        densities[k, 2 * birds - 1] = mean / birds**2


@kernel
def fill_responses(
    roots: ComplexArray,
    lag: float,
    constants: FloatArray,
    reverse: FloatArray,
    responses: ComplexArray,
) -> None:
    """Fill `responses` (roots, 2 birds - 1, birds): speeds and gaps per acceleration of a bird."""
    birds = constants.shape[1]
    left = np.empty((RESULTS, birds), dtype=np.complex128)
    right = np.empty((RESULTS, birds), dtype=np.complex128)
    for k in range(len(roots)):
        eliminate(roots[k], lag, constants, left)
        eliminate(roots[k], lag, reverse, right)
        for source in range(birds):
            speed = 1.0 / joined(left, right, source)[0]
            responses[k, source, source] = speed
            moved = speed
            for j in range(source - 1, -1, -1):
                responses[k, birds + j, source] = left[GAP, j] * moved
                moved = left[RATIO, j] * moved
                responses[k, j, source] = moved
            moved = speed
            for j in range(source + 1, birds):
                i = birds - 1 - j
                responses[k, birds + j - 1, source] = -right[GAP, i] * moved
                moved = right[RATIO, i] * moved
                responses[k, j, source] = moved
