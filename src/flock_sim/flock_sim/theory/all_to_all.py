# SPDX-License-Identifier: Apache-2.0
"""The steady state of all-to-all coupling: the minimum of a convex function.

At the common speed U* (see `steady_speed`) bird j feels D_ij = K_ij (E_ij + g(x_i - x_j)) of every
other, K_ij = Gamma_i Gamma_j / (4 pi), with g = I - E odd and falling. The forces

    F_j(x) = R_j - sum_i D_ij(x),    R_j = T_j - D_j(U*),

are therefore minus the gradient of a strictly convex function of the positions. So at most one
steady state exists, the Jacobian is a weighted Laplacian (weights K_ij f'(|x_i - x_j|)), and
Newton's method finds the state from any start. No steady state exists if a set S of birds still
loses speed when it falls far behind all others, in their full wake: if the share

    s_S = (sum_{S} R_j - sum_{pairs in S} C_ij) / sum_{pairs across} C_ij,    C_ij = D_ij + D_ji,

is 1 or more. Otherwise the convex function grows in every direction, and the state exists.
`worst_sets` finds the set with the largest share.
"""

import numpy as np
import numpy.typing as npt

from flock_sim.physics.aerodynamics import ahead_integral_and_slope, split_drag
from flock_sim.physics.arrays import FloatArray
from flock_sim.physics.compile import kernel
from flock_sim.theory.steady_speed import balance, steady_square

MOST_ITERATIONS = 200
MOST_HALVINGS = 60

CONVERGED = 1e-12
"""Largest step, relative to the size of the flock, after which the next one is only rounding."""

BALANCED = 1e-14
"""Largest force that rounding of positions can cause, relative to the largest force that birds
need, and per b of the flock's size. Such a force is rounding if a step does not halve it: effective
steps halve it, however far the solution is."""

OVERSHOOT = 0.5
"""Largest reverse force at the end of a step, relative to the force along the step at its start."""


@kernel
def fill_shares(
    span_ratio: FloatArray,
    thrust_ratio: FloatArray,
    pairs: npt.NDArray[np.int64],
    even: FloatArray,
    cruise_ratio: float,
    strength_unit: float,
    square: FloatArray,
    strength: FloatArray,
    needed: FloatArray,
    share: FloatArray,
) -> None:
    """Fill the quantities that do not depend on positions, for all members.

    `cruise_ratio` is H_0, `strength_unit` = Gamma_min^2 / (4 pi k). The function fills `square`
    (members,) with U*^2; `strength` (pairs, members) with K_ij / k; `needed` (birds, members) with
    R_j / k; and `share` (birds - 1, members) with the shares s_S of birds 1..i for each gap i.
    `span_ratio`, `pairs` and `even` are as in `Flock`, `thrust_ratio` as in `Equilibrium`.
    """
    birds, members = span_ratio.shape
    behind = np.empty(birds, dtype=np.bool_)
    for m in range(members):
        squares, fourths, saving, added = 0.0, 0.0, 0.0, 0.0
        for i in range(birds):
            ratio = span_ratio[i, m] * span_ratio[i, m]
            squares += ratio
            fourths += ratio * ratio
            added += ratio * ratio * (thrust_ratio[i, m] - 1.0)
        for k in range(pairs.shape[0]):
            product = span_ratio[pairs[k, 0], m] * span_ratio[pairs[k, 1], m]
            strength[k, m] = product * product * strength_unit
            saving += 2.0 * strength[k, m] * even[k, m]
        square[m] = steady_square(squares, fourths, saving, cruise_ratio, added)
        for k in range(pairs.shape[0]):
            strength[k, m] /= square[m]
        for i in range(birds):
            own = cruise_ratio * thrust_ratio[i, m]
            needed[i, m] = balance(span_ratio[i, m], square[m], own)
        behind[:] = False
        of_birds = needed[:, m].copy()
        saved = 2.0 * strength[:, m] * even[:, m]
        for i in range(birds - 1):
            behind[i] = True
            share[i, m] = share_of(behind, of_birds, pairs, saved)


@kernel
def share_of(
    behind: npt.NDArray[np.bool_],
    needed: FloatArray,
    pairs: npt.NDArray[np.int64],
    saved: FloatArray,
) -> float:
    """Return s_S of the set S of birds that are marked in `behind`, shape (birds,).

    `needed` are R_j / k of the birds, `saved` C_ij / k of the pairs.
    """
    carried, across = 0.0, 0.0
    for i in range(needed.shape[0]):
        if behind[i]:
            carried += needed[i]
    for k in range(pairs.shape[0]):
        i, j = pairs[k, 0], pairs[k, 1]
        if behind[i] != behind[j]:
            across += saved[k]
        elif behind[i]:
            carried -= saved[k]
    return carried / across


@kernel
def settle(
    position: FloatArray,
    needed: FloatArray,
    half_span: FloatArray,
    pairs: npt.NDArray[np.int64],
    lateral: FloatArray,
    even: FloatArray,
    strength: FloatArray,
) -> bool:
    """Find the steady state of one flock that has one; return whether the search converged.

    `position` (birds,), in b, is the start of the search, and then its result. `needed` are R_j / k
    of the birds, `strength` K_ij / k of the pairs; the others are as in `Flock`, for one member.
    """
    force = np.empty_like(position)
    stiffness = np.empty_like(strength)
    trial = np.empty_like(position)
    largest = np.max(np.abs(needed))
    _forces(position, needed, half_span, pairs, lateral, even, strength, force, stiffness)
    for _ in range(MOST_ITERATIONS):
        order = np.argsort(position)
        step = _newton_step(order, force, pairs, stiffness)
        along = np.dot(force, step)
        if not np.isfinite(along):
            break
        size = 1.0 + position[order[-1]] - position[order[0]]
        rest = np.max(np.abs(force))
        if np.max(np.abs(step)) <= CONVERGED * size:
            position += step
            return True
        length = 1.0
        for _ in range(MOST_HALVINGS):
            trial[:] = position + length * step
            _forces(trial, needed, half_span, pairs, lateral, even, strength, force, stiffness)
            if np.dot(force, step) >= -OVERSHOOT * along:
                break
            length *= 0.5
        position[:] = trial
        if rest <= BALANCED * size * largest and np.max(np.abs(force)) > 0.5 * rest:
            return True
    return False


@kernel
def _forces(
    position: FloatArray,
    needed: FloatArray,
    half_span: FloatArray,
    pairs: npt.NDArray[np.int64],
    lateral: FloatArray,
    even: FloatArray,
    strength: FloatArray,
    force: FloatArray,
    stiffness: FloatArray,
) -> None:
    """Fill F_j / k of each bird and the stiffness K_ij f' / k of each pair, for one flock."""
    force[:] = needed
    for k in range(pairs.shape[0]):
        i, j = pairs[k, 0], pairs[k, 1]
        x = position[j] - position[i]
        ahead, slope = ahead_integral_and_slope(abs(x), lateral[k], half_span[i], half_span[j])
        on_i, on_j = split_drag(x, strength[k], ahead, even[k])
        force[i] -= on_i
        force[j] -= on_j
        stiffness[k] = strength[k] * slope


@kernel
def _newton_step(
    order: npt.NDArray[np.int64],
    force: FloatArray,
    pairs: npt.NDArray[np.int64],
    stiffness: FloatArray,
) -> FloatArray:
    """Return the changes of position of a Newton step; that of the middle bird is 0.

    The unknowns are the distances between birds in their streamwise `order`, each scaled by its own
    stiffness. With this scaling, birds far apart are no harder to move than close ones.
    """
    birds = len(order)
    rank = np.empty_like(order)
    rank[order] = np.arange(birds)
    matrix = np.zeros((birds - 1, birds - 1))
    for k in range(pairs.shape[0]):
        first = min(rank[pairs[k, 0]], rank[pairs[k, 1]])
        last = max(rank[pairs[k, 0]], rank[pairs[k, 1]])
        matrix[first:last, first:last] += stiffness[k]
    scale = 1.0 / np.sqrt(np.diag(matrix))
    pull = -np.cumsum(force[order])[:-1]
    widening = scale * np.linalg.solve(matrix * np.outer(scale, scale), scale * pull)
    step = np.zeros(birds)
    step[order[1:]] = np.cumsum(widening)
    step -= step[birds // 2]
    return step
