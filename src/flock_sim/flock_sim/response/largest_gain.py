# SPDX-License-Identifier: Apache-2.0
"""The largest singular value of the response of a chain's gaps to accelerations of all birds.

The response G of the gaps (birds - 1) to the accelerations (birds) is never formed: `elimination`
gives G f and G* y in a time proportional to the number of birds. Both wings are eliminated towards
the leader: a late bird hardly sees the bird behind it, so in the other direction forces passed on
would grow without bound, and cancel. The Lanczos method, with full
reorthogonalisation, finds the largest eigenvalue of G G*. With its singular vectors p and q, the
derivative of the singular value by omega is Re(p* i G'(s) q).
"""

from __future__ import annotations

import numpy as np

from flock_sim.physics.arrays import FloatArray
from flock_sim.physics.compile import kernel
from flock_sim.response.elimination import (
    GAP,
    GAP_SLOPE,
    PASSED,
    PASSED_SLOPE,
    PIVOT,
    PIVOT_SLOPE,
    RATIO,
    RATIO_SLOPE,
    RESULTS,
    ComplexArray,
    eliminate,
    joined,
)

MOST_VECTORS = 48
"""Largest number of Lanczos vectors; then the method begins again with the best combination."""

MOST_ROUNDS = 40

CONVERGED = 1e-9
"""Largest residual of the eigenvector of G G*, relative to its eigenvalue.

The error of the eigenvalue is of the order of the square of the residual.
"""


@kernel
def fill_largest_gains(
    roots: ComplexArray,
    lag: float,
    constants: FloatArray,
    reverse: FloatArray,
    leader: int,
    start: ComplexArray,
    gains: FloatArray,
    slopes: FloatArray,
) -> None:
    """Fill the logarithms of the largest singular values, and their derivatives by omega.

    Both have shape (roots,); `start` (birds - 1,) is the first vector, one or more.
    """
    birds = constants.shape[1]
    both = np.empty((2, RESULTS, birds), dtype=np.complex128)
    size = min(birds - 1, MOST_VECTORS)
    vectors = np.empty((size + 1, birds - 1), dtype=np.complex128)
    force = np.empty(birds, dtype=np.complex128)
    gap = np.empty(birds - 1, dtype=np.complex128)
    gap_slope = np.empty(birds - 1, dtype=np.complex128)
    for k in range(len(roots)):
        eliminate(roots[k], lag, constants, both[0])
        eliminate(roots[k], lag, reverse, both[1])
        own, own_slope = joined(both[0], both[1], leader)
        best = start.copy()
        for _ in range(MOST_ROUNDS):
            if _lanczos(roots[k], both, own, leader, vectors, force, gap, best):
                break
        _accelerations(roots[k], both, own, leader, best, force)
        square = np.sum(np.abs(force) ** 2)
        gains[k] = 0.5 * np.log(square)
        # `best` is p, `force` is G* p = sigma q
        _gap_slopes(roots[k], both, own, own_slope, leader, force, gap_slope)
        slopes[k] = -np.sum(np.conj(best) * gap_slope).imag / square


@kernel
def _lanczos(
    root: complex,
    both: ComplexArray,
    own: complex,
    leader: int,
    vectors: ComplexArray,
    force: ComplexArray,
    gap: ComplexArray,
    best: ComplexArray,
) -> bool:
    """Improve `best`, the eigenvector of G G* with the largest eigenvalue; whether it converged."""
    size = vectors.shape[0] - 1
    matrix = np.zeros((size, size))
    vectors[0] = best / np.sqrt(np.sum(np.abs(best) ** 2))
    for k in range(size):
        _accelerations(root, both, own, leader, vectors[k], force)
        _gaps(root, both, own, leader, force, gap)
        matrix[k, k] = np.sum(np.conj(vectors[k]) * gap).real
        for _ in range(2):
            for i in range(k + 1):
                gap -= np.sum(np.conj(vectors[i]) * gap) * vectors[i]
        rest = np.sqrt(np.sum(np.abs(gap) ** 2))
        done = rest <= CONVERGED * np.max(np.diag(matrix))
        if done or k == size - 1 or k % 4 == 3:
            values, combinations = np.linalg.eigh(matrix[: k + 1, : k + 1])
            converged: bool = done or rest * abs(combinations[k, k]) <= CONVERGED * values[k]
            if converged or k == size - 1:
                best[:] = 0.0
                for i in range(k + 1):
                    best += combinations[i, k] * vectors[i]
                best /= np.sqrt(np.sum(np.abs(best) ** 2))
                return converged
        vectors[k + 1] = gap / rest
        matrix[k, k + 1] = matrix[k + 1, k] = rest
    return False


@kernel
def _gaps(
    root: complex,
    both: ComplexArray,
    own: complex,
    leader: int,
    force: ComplexArray,
    gap: ComplexArray,
) -> None:
    """Fill G f; `force` (birds,) is f, and is changed. `both` are the eliminations in both orders.

    `own` is A of the leader.
    """
    last = len(force) - 1
    for side in range(2):
        results, step = both[side], 1 - 2 * side
        for i in range(leader if side == 0 else last - leader):
            j = i if side == 0 else last - i
            force[j + step] += results[PASSED, i] * force[j]
    for side in range(2):
        results, sign = both[side], 1.0 - 2.0 * side
        speed = force[leader] / own
        for i in range((leader if side == 0 else last - leader) - 1, -1, -1):
            j = i if side == 0 else last - i
            moved = force[j] / results[PIVOT, i]
            gap[j - side] = sign * (results[GAP, i] * speed - moved)
            speed = results[RATIO, i] * speed + root * moved


@kernel
def _accelerations(
    root: complex,
    both: ComplexArray,
    own: complex,
    leader: int,
    gap: ComplexArray,
    force: ComplexArray,
) -> None:
    """Fill G* y, `force` (birds,), of y, `gap` (birds - 1,): the steps of `_gaps` backwards."""
    last = len(force) - 1
    force[leader] = 0.0
    for side in range(2):
        results, sign = both[side], 1.0 - 2.0 * side
        speed = 0.0j
        for i in range(leader if side == 0 else last - leader):
            j = i if side == 0 else last - i
            given = sign * gap[j - side]
            force[j] = np.conj(1.0 / results[PIVOT, i]) * (np.conj(root) * speed - given)
            speed = np.conj(results[GAP, i]) * given + np.conj(results[RATIO, i]) * speed
        force[leader] += speed / np.conj(own)
    for side in range(2):
        results, step = both[side], 1 - 2 * side
        for i in range((leader if side == 0 else last - leader) - 1, -1, -1):
            j = i if side == 0 else last - i
            force[j] += np.conj(results[PASSED, i]) * force[j + step]


@kernel
def _gap_slopes(
    root: complex,
    both: ComplexArray,
    own: complex,
    own_slope: complex,
    leader: int,
    force: ComplexArray,
    gap_slope: ComplexArray,
) -> None:
    """Fill dG/ds f; `force` (birds,) is f, and is changed."""
    last = len(force) - 1
    force_slope = np.zeros(last + 1, dtype=np.complex128)
    for side in range(2):
        results, step = both[side], 1 - 2 * side
        for i in range(leader if side == 0 else last - leader):
            j = i if side == 0 else last - i
            passed, passed_slope = results[PASSED, i], results[PASSED_SLOPE, i]
            force_slope[j + step] += passed_slope * force[j] + passed * force_slope[j]
            force[j + step] += passed * force[j]
    for side in range(2):
        results, sign = both[side], 1.0 - 2.0 * side
        speed = force[leader] / own
        speed_slope = (force_slope[leader] - speed * own_slope) / own
        for i in range((leader if side == 0 else last - leader) - 1, -1, -1):
            j = i if side == 0 else last - i
            moved = force[j] / results[PIVOT, i]
            moved_slope = (force_slope[j] - moved * results[PIVOT_SLOPE, i]) / results[PIVOT, i]
            gap_slope[j - side] = sign * (
                results[GAP_SLOPE, i] * speed + results[GAP, i] * speed_slope - moved_slope
            )
            speed_slope = (
                results[RATIO_SLOPE, i] * speed
                + results[RATIO, i] * speed_slope
                + moved
                + root * moved_slope
            )
            speed = results[RATIO, i] * speed + root * moved
