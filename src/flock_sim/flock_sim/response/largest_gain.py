# SPDX-License-Identifier: Apache-2.0
"""The largest singular value of the response of a chain's gaps to accelerations of all birds.

The response G of the gaps (birds - 1) to the accelerations f (birds) is never formed. With the
eliminations L in order and R in reverse order, and the own responses V_j = 1 / A_j of the birds,

    y_j = V_j f_j + r^R_j y_{j-1}
    z_j = V_j f_j + r^L_j z_{j+1}    g_j = d^L_j z_{j+1} - d^R_{j+1} y_j

where y_j and z_j are the speeds of bird j by accelerations of birds up to j, and of birds from j.
So G f and G* y take a time proportional to the number of birds, and nothing cancels. The Lanczos
method, with full reorthogonalisation, finds the largest eigenvalue of G G*. With its singular
vectors p and q, the derivative of the singular value by omega is Re(p* i G'(s) q).
"""

from __future__ import annotations

import numpy as np

from flock_sim.physics.arrays import FloatArray
from flock_sim.physics.compile import kernel
from flock_sim.response.elimination import (
    GAP,
    GAP_SLOPE,
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

# Rows of the coefficients of G, shape (5, birds): V, r^L, r^R, d^L, and d^R of the next bird.
OWN, FROM_NEXT, FROM_LAST, GAP_FROM_NEXT, GAP_FROM_LAST = 0, 1, 2, 3, 4
COEFFICIENTS = 5


@kernel
def fill_largest_gains(
    roots: ComplexArray,
    lag: float,
    constants: FloatArray,
    reverse: FloatArray,
    start: ComplexArray,
    gains: FloatArray,
    slopes: FloatArray,
) -> None:
    """Fill the logarithms of the largest singular values, and their derivatives by omega.

    Both have shape (roots,); `start` (birds - 1,) is the first vector, one or more.
    """
    birds = constants.shape[1]
    left = np.empty((RESULTS, birds), dtype=np.complex128)
    right = np.empty((RESULTS, birds), dtype=np.complex128)
    of, of_slope = (
        np.zeros((COEFFICIENTS, birds), dtype=np.complex128),
        np.zeros((COEFFICIENTS, birds), dtype=np.complex128),
    )
    vectors = np.empty((min(birds - 1, MOST_VECTORS) + 1, birds - 1), dtype=np.complex128)
    force = np.empty(birds, dtype=np.complex128)
    gap = np.empty(birds - 1, dtype=np.complex128)
    for k in range(len(roots)):
        eliminate(roots[k], lag, constants, left)
        eliminate(roots[k], lag, reverse, right)
        _fill_coefficients(left, right, of, of_slope)
        best = start.copy()
        for _ in range(MOST_ROUNDS):
            if _lanczos(of, vectors, force, gap, best):
                break
        _accelerations(of, best, force)
        square = np.sum(np.abs(force) ** 2)
        gains[k] = 0.5 * np.log(square)
        # `best` is p, `force` is G* p = sigma q
        _gap_slopes(of, of_slope, force, gap)
        slopes[k] = -np.sum(np.conj(best) * gap).imag / square


@kernel
def _fill_coefficients(
    left: ComplexArray, right: ComplexArray, of: ComplexArray, of_slope: ComplexArray
) -> None:
    birds = left.shape[1]
    for j in range(birds):
        own, own_slope = joined(left, right, j)
        of[OWN, j], of_slope[OWN, j] = 1.0 / own, -own_slope / (own * own)
        i = birds - 1 - j
        if j < birds - 1:
            of[FROM_NEXT, j], of_slope[FROM_NEXT, j] = left[RATIO, j], left[RATIO_SLOPE, j]
            of[GAP_FROM_NEXT, j], of_slope[GAP_FROM_NEXT, j] = left[GAP, j], left[GAP_SLOPE, j]
        if j > 0:
            of[FROM_LAST, j], of_slope[FROM_LAST, j] = right[RATIO, i], right[RATIO_SLOPE, i]
            of[GAP_FROM_LAST, j - 1] = right[GAP, i]
            of_slope[GAP_FROM_LAST, j - 1] = right[GAP_SLOPE, i]


@kernel
def _lanczos(
    of: ComplexArray,
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
        _accelerations(of, vectors[k], force)
        _gaps(of, force, gap)
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
def _gaps(of: ComplexArray, force: ComplexArray, gap: ComplexArray) -> None:
    """Fill G f, `gap` (birds - 1,), of f, `force` (birds,)."""
    last = len(force) - 1
    speed = 0.0j
    for j in range(last):
        speed = of[OWN, j] * force[j] + of[FROM_LAST, j] * speed
        gap[j] = -of[GAP_FROM_LAST, j] * speed
    speed = 0.0j
    for j in range(last, 0, -1):
        speed = of[OWN, j] * force[j] + of[FROM_NEXT, j] * speed
        gap[j - 1] += of[GAP_FROM_NEXT, j - 1] * speed


@kernel
def _accelerations(of: ComplexArray, gap: ComplexArray, force: ComplexArray) -> None:
    """Fill G* y, `force` (birds,), of y, `gap` (birds - 1,): the steps of `_gaps` backwards."""
    last = len(force) - 1
    force[last] = 0.0
    speed = 0.0j
    for j in range(last - 1, -1, -1):
        speed = np.conj(of[FROM_LAST, j + 1]) * speed - np.conj(of[GAP_FROM_LAST, j]) * gap[j]
        force[j] = np.conj(of[OWN, j]) * speed
    speed = 0.0j
    for j in range(1, last + 1):
        speed = (
            np.conj(of[FROM_NEXT, j - 1]) * speed + np.conj(of[GAP_FROM_NEXT, j - 1]) * gap[j - 1]
        )
        force[j] += np.conj(of[OWN, j]) * speed


@kernel
def _gap_slopes(
    of: ComplexArray, of_slope: ComplexArray, force: ComplexArray, gap: ComplexArray
) -> None:
    """Fill dG/ds f, `gap` (birds - 1,), of f, `force` (birds,)."""
    last = len(force) - 1
    for side in range(2):
        ratio, distance = (FROM_LAST, GAP_FROM_LAST) if side == 0 else (FROM_NEXT, GAP_FROM_NEXT)
        speed, slope = 0.0j, 0.0j
        for k in range(last):
            j = k if side == 0 else last - k
            slope = of_slope[OWN, j] * force[j] + of_slope[ratio, j] * speed + of[ratio, j] * slope
            speed = of[OWN, j] * force[j] + of[ratio, j] * speed
            if side == 0:
                gap[j] = -of_slope[distance, j] * speed - of[distance, j] * slope
            else:
                gap[j - 1] += of_slope[distance, j - 1] * speed + of[distance, j - 1] * slope
