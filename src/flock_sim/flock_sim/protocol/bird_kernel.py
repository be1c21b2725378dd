# SPDX-License-Identifier: Apache-2.0
"""One bird's Runge-Kutta stage: from its neighbours' messages to its own next values."""

from __future__ import annotations

import numpy as np

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.messages.stage_layout import FIRST_WORD
from flock_sim.physics import formation
from flock_sim.physics.arrays import FloatArray
from flock_sim.physics.compile import kernel
from flock_sim.physics.dynamics import acceleration, circulation_at, drag_of_pair, stage_value
from flock_sim.physics.runge_kutta import STAGES
from flock_sim.physics.scaling import BirdCoefficients, Scales

# Rows of a bird's own constants: its coefficients, as BirdCoefficients.rows() has them, and a_j.
MASS, THRUST, PROFILE_DRAG, INDUCED_DRAG, CIRCULATION, HALF_SPAN = range(6)

# Rows of a bird's working memory.
DRAG, POSITION, SPEED, VELOCITY_SLOPES, SPEED_SLOPES = 0, 1, 2, 3, 3 + STAGES
WORK_ROWS = SPEED_SLOPES + STAGES


def constants(bird: int, configuration: FlockConfiguration) -> FloatArray:
    """Return a bird's own constants, shape (6, members)."""
    ratio = configuration.span_ratio[bird - 1]
    coefficients = BirdCoefficients.of(Scales.of(configuration), ratio)
    return np.vstack([coefficients.rows(), formation.VORTEX_FRACTION * ratio])


@kernel
def begin(own: FloatArray, mine: FloatArray, work: FloatArray) -> None:
    """Fill the words of the first stage from the values in `work`."""
    members = own.shape[1]
    for m in range(members):
        at = FIRST_WORD + m
        mine[0, at] = work[POSITION, m]
        mine[0, at + members + 1] = work[SPEED, m]
        mine[0, at + 2 * (members + 1)] = circulation_at(work[SPEED, m], own[CIRCULATION, m])


@kernel
def feel_and_move(
    tick: int,
    dt: float,
    own: FloatArray,
    geometry: FloatArray,
    heard: FloatArray,
    mine: FloatArray,
    work: FloatArray,
) -> None:
    """Compute the drag at `tick` and the values at the next tick.

    The arrays are few, since each costs 0.2 us to pass. `own` (6, members) holds the coefficients
    and the half-span; `geometry` (neighbours, 3, members) the lateral distance, half-span and E of
    each neighbour; `heard` (2, neighbours, words) and `mine` (2, words) the stage messages of even
    and odd ticks; `work` (11, members) the drag, the values at the beginning of the step and the
    slopes so far. The function fills `mine` of the next tick, and at the last stage the values in
    `work`.
    """
    members = own.shape[1]
    stage = tick % STAGES
    now = mine[tick & 1]
    following = mine[1 - (tick & 1)]
    position = FIRST_WORD
    speed = FIRST_WORD + members + 1
    circulation = FIRST_WORD + 2 * (members + 1)
    velocity_slopes = work[VELOCITY_SLOPES : VELOCITY_SLOPES + STAGES]
    speed_slopes = work[SPEED_SLOPES : SPEED_SLOPES + STAGES]

    for m in range(members):
        work[DRAG, m] = 0.0
    for k in range(geometry.shape[0]):
        other = heard[tick & 1, k]
        for m in range(members):
            on_me, _ = drag_of_pair(
                other[position + m] - now[position + m],
                geometry[k, 0, m],
                own[HALF_SPAN, m],
                geometry[k, 1, m],
                geometry[k, 2, m],
                now[circulation + m],
                other[circulation + m],
            )
            work[DRAG, m] += on_me

    last = stage + 1 == STAGES
    for m in range(members):
        velocity_slopes[stage, m] = now[speed + m]
        speed_slopes[stage, m] = acceleration(
            now[speed + m],
            work[DRAG, m],
            own[MASS, m],
            own[THRUST, m],
            own[PROFILE_DRAG, m],
            own[INDUCED_DRAG, m],
        )
        new_position = stage_value(work[POSITION, m], dt, velocity_slopes, stage + 1, m)
        new_speed = stage_value(work[SPEED, m], dt, speed_slopes, stage + 1, m)
        if last:
            work[POSITION, m] = new_position
            work[SPEED, m] = new_speed
        following[position + m] = new_position
        following[speed + m] = new_speed
        following[circulation + m] = circulation_at(new_speed, own[CIRCULATION, m])
