# SPDX-License-Identifier: Apache-2.0
"""Linear stability: the Jacobian of the equations of motion, and its eigenvalues."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from flock_sim.physics import formation
from flock_sim.physics.aerodynamics import ahead_integral_and_slope, split_drag
from flock_sim.physics.arrays import FloatArray
from flock_sim.physics.compile import kernel
from flock_sim.physics.flock import Flock
from flock_sim.physics.interaction import PER_FOUR_PI

ComplexArray = npt.NDArray[np.complex128]

BLOCK = 4096
"""Largest number of members for which Jacobians are held at once."""


def jacobian(flock: Flock, position: FloatArray, speed: FloatArray) -> FloatArray:
    """Return d(dx/dt, dU/dt) / d(x, U) of Eqs. (eom2) for every member at a state.

    `position` and `speed` have shape (birds, members); the result has shape (members, 2 birds,
    2 birds), rows and columns x_1..x_N, U_1..U_N, dimensionless. Speeds may differ.
    """
    matrix = np.zeros((flock.members, 2 * flock.birds, 2 * flock.birds))
    _fill_jacobian(
        position,
        speed,
        flock.coefficients,
        flock.half_span,
        flock.pairs,
        flock.lateral,
        flock.even,
        matrix,
    )
    return matrix


def eigenvalues(flock: Flock, spacing: FloatArray, speed: FloatArray) -> ComplexArray:
    """Return the 2N - 1 eigenvalues of the steady state that describe its response.

    `spacing` (birds - 1, members) and `speed` (members,) are those of an `Equilibrium`. The result
    has shape (members, 2 birds - 1), in U_min / b, ordered by falling real part; nan if no state is
    given. The eigenvalue number 2N is 0: the translation of the whole flock. It is removed by the
    use of spacings instead of positions.
    """
    birds, members = flock.birds, flock.members
    found = np.full((members, 2 * birds - 1), complex(np.nan, np.nan))
    known = np.flatnonzero(np.isfinite(speed))
    for first in range(0, len(known), BLOCK):
        block = known[first : first + BLOCK]
        part = flock.select(block)
        position = formation.positions(spacing[:, block])
        common = np.broadcast_to(speed[block], position.shape)
        found[block] = np.linalg.eigvals(_by_spacings(jacobian(part, position, common)))
    order = np.argsort(-found.real, axis=1, kind="stable")
    return np.take_along_axis(found, order, axis=1)


def _by_spacings(matrix: FloatArray) -> FloatArray:
    """Return the Jacobian with spacings x_{i+1} - x_i instead of positions: one row less."""
    members, birds = matrix.shape[0], matrix.shape[1] // 2
    reduced = np.zeros((members, 2 * birds - 1, 2 * birds - 1))
    gaps = birds - 1
    reduced[:, :gaps, gaps:] = np.diff(np.eye(birds), axis=0)
    # Opening gap i moves all birds after it.
    by_position = matrix[:, birds:, :birds]
    reduced[:, gaps:, :gaps] = np.cumsum(by_position[:, :, :0:-1], axis=2)[:, :, ::-1]
    reduced[:, gaps:, gaps:] = matrix[:, birds:, birds:]
    return reduced


@kernel
def _fill_jacobian(
    position: FloatArray,
    speed: FloatArray,
    coefficients: FloatArray,
    half_span: FloatArray,
    pairs: npt.NDArray[np.int64],
    lateral: FloatArray,
    even: FloatArray,
    matrix: FloatArray,
) -> None:
    birds, members = position.shape
    for m in range(members):
        rows = matrix[m]
        for i in range(birds):
            rows[i, birds + i] = 1.0
            u = speed[i, m]
            profile, induced = coefficients[i, 2, m], coefficients[i, 3, m]
            rows[birds + i, birds + i] = -2.0 * (profile * u - induced / (u * u * u))
        for k in range(pairs.shape[0]):
            i, j = pairs[k, 0], pairs[k, 1]
            x = position[j, m] - position[i, m]
            ahead, slope = ahead_integral_and_slope(
                abs(x), lateral[k, m], half_span[i, m], half_span[j, m]
            )
            strength = PER_FOUR_PI * coefficients[i, 4, m] / speed[i, m]
            strength *= coefficients[j, 4, m] / speed[j, m]
            on_i, on_j = split_drag(x, strength, ahead, even[k, m])
            # A bird that moves back gains; the other one loses the same amount.
            pull = strength * slope
            rows[birds + i, i] -= pull
            rows[birds + i, j] += pull
            rows[birds + j, j] -= pull
            rows[birds + j, i] += pull
            # Drags go as 1 / (U_i U_j).
            rows[birds + i, birds + i] += on_i / speed[i, m]
            rows[birds + i, birds + j] += on_i / speed[j, m]
            rows[birds + j, birds + j] += on_j / speed[j, m]
            rows[birds + j, birds + i] += on_j / speed[i, m]
        for i in range(birds):
            rows[birds + i] /= coefficients[i, 0, m]
