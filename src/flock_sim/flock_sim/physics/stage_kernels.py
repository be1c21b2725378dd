# SPDX-License-Identifier: Apache-2.0
"""The two loops of a Runge-Kutta stage: the drags of many pairs, and the motion of many birds.

A bird and the reference run the same loops. Their innermost axis has one element for each bird or
pair and member, contiguous in memory, so the compiler vectorises them, whether a single flock or
an ensemble is flown. An element never depends on another one. So the bits are the same for any
length of vectors.
"""

from __future__ import annotations

import numpy as np

from flock_sim.physics.aerodynamics import even_part
from flock_sim.physics.arrays import FloatArray
from flock_sim.physics.compile import inlined, kernel
from flock_sim.physics.dynamics import acceleration, canonical, drag_of_pair
from flock_sim.physics.runge_kutta import STAGES, TABLEAU

LANES = 8
"""The number of elements of an interaction array is a multiple of this: no vector is partial."""

# Rows of an interaction array, shape (9, elements), with one element for each pair and member.
# Constants of the pair: |y|, a, a' and E.
LATERAL, HALF_SPAN, OTHER_HALF_SPAN, EVEN = range(4)
# Its present values: the position of the other bird minus that of the bird, and both circulations.
DISTANCE, CIRCULATION, OTHER_CIRCULATION = range(4, 7)
# The results: the drags on the bird and on the other bird.
ON_BIRD, ON_OTHER = 7, 8
ROWS = 9


def interaction_array(pairs: int, members: int) -> FloatArray:
    """Return an interaction array for pairs that `fill_interactions` adds.

    Element `pair * members + member` is that of a pair in a member. The elements after the last
    pair have no drag.
    """
    array = np.zeros((ROWS, elements(pairs * members)))
    array[LATERAL], array[HALF_SPAN], array[OTHER_HALF_SPAN] = 2.0, 0.5, 0.5
    return array


@kernel
def elements(count: int) -> int:
    """Return the number of elements of an interaction array for `count` of them."""
    return LANES * max(1, -(-count // LANES))


@kernel
def fill_interactions(
    interactions: FloatArray,
    first: int,
    lateral: FloatArray,
    half_span: FloatArray,
    other_half_span: FloatArray,
) -> None:
    """Fill in the constants of the elements from `first`; the others have shape (elements,)."""
    for m in range(lateral.shape[0]):
        interactions[LATERAL, first + m] = lateral[m]
        interactions[HALF_SPAN, first + m] = half_span[m]
        interactions[OTHER_HALF_SPAN, first + m] = other_half_span[m]
        interactions[EVEN, first + m] = even_part(lateral[m], half_span[m], other_half_span[m])


@kernel
def compute_drags(interactions: FloatArray) -> None:
    """Compute the drags of all pairs, in rho b^2 U_min^2. Eq. (Djk2)."""
    lateral, even = interactions[LATERAL], interactions[EVEN]
    half_span, other_half_span = interactions[HALF_SPAN], interactions[OTHER_HALF_SPAN]
    distance = interactions[DISTANCE]
    circulation, other_circulation = interactions[CIRCULATION], interactions[OTHER_CIRCULATION]
    on_bird, on_other = interactions[ON_BIRD], interactions[ON_OTHER]
    for k in range(interactions.shape[1]):
        on_bird[k], on_other[k] = drag_of_pair(
            distance[k],
            lateral[k],
            half_span[k],
            other_half_span[k],
            even[k],
            circulation[k],
            other_circulation[k],
        )


@inlined
def sum_up(
    step: int,
    every: int,
    speed: FloatArray,
    drag: FloatArray,
    speed_sum: FloatArray,
    drag_sum: FloatArray,
) -> None:
    """Add speed and drag at the beginning of `step` to the sums of which a record has the means.

    States are recorded `every` steps. The sums begin anew at the step after a record. All arrays
    have shape (elements,).
    """
    anew = step == 0 or (step - 1) % every == 0
    for i in range(speed.shape[0]):
        speed_sum[i] = canonical((0.0 if anew else speed_sum[i]) + speed[i])
        drag_sum[i] = canonical((0.0 if anew else drag_sum[i]) + drag[i])


@inlined
def move(
    stage: int,
    dt: float,
    coefficients: FloatArray,
    drag: FloatArray,
    position: FloatArray,
    speed: FloatArray,
    position_slopes: FloatArray,
    speed_slopes: FloatArray,
    position_now: FloatArray,
    speed_now: FloatArray,
) -> None:
    """Replace the values at `stage` by those at the next stage, or at the end of the step.

    All arrays have shape (elements,) but `coefficients`, (5, elements): one element for each bird
    and member. `position` and `speed` are those at the beginning of the step; the `slopes` are the
    weighted sums of the slopes at the stages so far.
    """
    first, last = stage == 0, stage + 1 == STAGES
    step = TABLEAU[stage + 1, stage]
    weight = TABLEAU[STAGES, stage]
    mass, thrust = coefficients[0], coefficients[1]
    profile, induced = coefficients[2], coefficients[3]
    for i in range(position.shape[0]):
        position_slope = speed_now[i]
        speed_slope = acceleration(
            position_slope, drag[i], mass[i], thrust[i], profile[i], induced[i]
        )
        position_sum = (0.0 if first else position_slopes[i]) + weight * position_slope
        speed_sum = (0.0 if first else speed_slopes[i]) + weight * speed_slope
        position_slopes[i], speed_slopes[i] = position_sum, speed_sum
        position_now[i] = canonical(
            position[i] + dt * (position_sum if last else step * position_slope)
        )
        speed_now[i] = canonical(speed[i] + dt * (speed_sum if last else step * speed_slope))
