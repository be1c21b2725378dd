# SPDX-License-Identifier: Apache-2.0
"""One bird's Runge-Kutta stage: from its neighbours' messages to its own next values."""

from __future__ import annotations

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.forcing import frame
from flock_sim.forcing.stage import compute_force
from flock_sim.messages.stage_layout import FIRST_WORD
from flock_sim.physics.arrays import FloatArray, IntArray
from flock_sim.physics.compile import kernel
from flock_sim.physics.dynamics import canonical, circulation_at, drag_of_pair
from flock_sim.physics.runge_kutta import STAGES
from flock_sim.physics.scaling import BirdCoefficients, Scales
from flock_sim.physics.stage_kernels import (
    CIRCULATION,
    DISTANCE,
    EVEN,
    HALF_SPAN,
    LATERAL,
    ON_BIRD,
    OTHER_CIRCULATION,
    OTHER_HALF_SPAN,
    compute_drags,
    move,
    sum_up,
)

# Rows of a bird's own constants, as BirdCoefficients.rows() has them.
THRUST, CIRCULATION_COEFFICIENT = 1, 4
OWN_ROWS = 5

# Rows of a bird's working memory: the drag, the values at the beginning of the step, the weighted
# sums of their slopes, the sums of `sum_up` with this step, and these sums before this step.
DRAG, POSITION, SPEED, POSITION_SLOPES, SPEED_SLOPES = range(5)
SPEED_SUM, DRAG_SUM, SPEED_SUM_BEFORE, DRAG_SUM_BEFORE = range(5, 9)
WORK_ROWS = 9

FEW = 4
"""Number of neighbours times members below which a vector costs more than single numbers."""


def constants(bird: int, configuration: FlockConfiguration) -> FloatArray:
    """Return a bird's own constants, shape (5, members)."""
    ratio = configuration.span_ratio[bird - 1]
    return BirdCoefficients.of(Scales.of(configuration), ratio).rows()


@kernel
def begin(own: FloatArray, mine: FloatArray, work: FloatArray) -> None:
    """Fill the words of the first stage from the values in `work`."""
    members = own.shape[1]
    for m in range(members):
        at = FIRST_WORD + m
        mine[0, at] = work[POSITION, m]
        mine[0, at + members + 1] = work[SPEED, m]
        mine[0, at + 2 * (members + 1)] = circulation_at(
            work[SPEED, m], own[CIRCULATION_COEFFICIENT, m]
        )


@kernel
def feel_and_move(
    tick: int,
    dt: float,
    every: int,
    own: FloatArray,
    interactions: FloatArray,
    heard: FloatArray,
    mine: FloatArray,
    work: FloatArray,
    forcing: IntArray,
) -> None:
    """Compute the drag at `tick` and the values at the next tick.

    `every` is the number of steps between recorded states. To compute a stage twice has no effect.
    The arrays are few, since each costs 0.2 us to pass. `own` (5, members) holds the coefficients,
    `interactions` is the interaction array of the neighbours; `heard` (2, neighbours, words) and
    `mine` (2, words) are the stage messages of even and odd ticks; `work` is (9, members). The
    function fills `mine` of the next tick, and at the last stage the values in `work`. `forcing`
    are the words of the forcing of the bird, none without it; a fault of a law is noted in them.
    """
    members = own.shape[1]
    now, following = mine[tick & 1], mine[1 - (tick & 1)]
    position = FIRST_WORD
    speed = FIRST_WORD + members + 1
    circulation = FIRST_WORD + 2 * (members + 1)

    for m in range(members):
        work[DRAG, m] = 0.0
    if heard.shape[1] * members < FEW:
        for k in range(heard.shape[1]):
            other = heard[tick & 1, k]
            for m in range(members):
                on_me, _ = drag_of_pair(
                    other[position + m] - now[position + m],
                    interactions[LATERAL, k * members + m],
                    interactions[HALF_SPAN, k * members + m],
                    interactions[OTHER_HALF_SPAN, k * members + m],
                    interactions[EVEN, k * members + m],
                    now[circulation + m],
                    other[circulation + m],
                )
                work[DRAG, m] = canonical(work[DRAG, m] + on_me)
    else:
        for k in range(heard.shape[1]):
            other = heard[tick & 1, k]
            for m in range(members):
                at = k * members + m
                interactions[DISTANCE, at] = other[position + m] - now[position + m]
                interactions[CIRCULATION, at] = now[circulation + m]
                interactions[OTHER_CIRCULATION, at] = other[circulation + m]
        compute_drags(interactions)
        for k in range(heard.shape[1]):
            for m in range(members):
                on_me = interactions[ON_BIRD, k * members + m]
                work[DRAG, m] = canonical(work[DRAG, m] + on_me)

    if tick % STAGES == 0:
        for m in range(members):
            work[SPEED_SUM, m] = work[SPEED_SUM_BEFORE, m]
            work[DRAG_SUM, m] = work[DRAG_SUM_BEFORE, m]
        speed_here = now[speed : speed + members]
        step = tick // STAGES
        sum_up(step, every, speed_here, work[DRAG], work[SPEED_SUM], work[DRAG_SUM])

    if forcing.shape[0] > 0:
        _add_force(tick, dt, own, heard[tick & 1], now, forcing)

    position_now = following[position : position + members]
    speed_now = following[speed : speed + members]
    for m in range(members):
        speed_now[m] = now[speed + m]
    move(
        tick % STAGES,
        dt,
        own,
        work[DRAG],
        work[POSITION],
        work[SPEED],
        work[POSITION_SLOPES],
        work[SPEED_SLOPES],
        position_now,
        speed_now,
    )
    for m in range(members):
        following[circulation + m] = circulation_at(speed_now[m], own[CIRCULATION_COEFFICIENT, m])
    if tick % STAGES + 1 == STAGES:
        for m in range(members):
            work[POSITION, m] = position_now[m]
            work[SPEED, m] = speed_now[m]
            work[SPEED_SUM_BEFORE, m] = work[SPEED_SUM, m]
            work[DRAG_SUM_BEFORE, m] = work[DRAG_SUM, m]


@kernel
def _add_force(
    tick: int,
    dt: float,
    own: FloatArray,
    heard: FloatArray,
    now: FloatArray,
    forcing: IntArray,
) -> None:
    """Set the thrust of a bird to that without forcing plus the force of its laws at `tick`.

    `heard` (neighbours, words) and `now` (words,) are the stage messages of this tick.
    """
    members, count = forcing[frame.MEMBERS], forcing[frame.NEIGHBOURS]
    present = frame.matrix(forcing[frame.NOW], 3, members)
    near = frame.matrix(forcing[frame.NEAR], 3 * members, count)
    for row in range(3):
        at = FIRST_WORD + row * (members + 1)
        for m in range(members):
            present[row, m] = now[at + m]
        if forcing[frame.LOOKS]:
            for k in range(count):
                for m in range(members):
                    near[row * members + m, k] = heard[k, at + m]
    compute_force(forcing, tick, dt)
    thrust = frame.matrix(forcing[frame.OWN], frame.OWN_ROWS, members)[frame.THRUST]
    force = frame.vector(forcing[frame.FORCE], members)
    for m in range(members):
        own[THRUST, m] = thrust[m] + force[m]
