# SPDX-License-Identifier: Apache-2.0
"""A Runge-Kutta stage of a whole flock: the drags on all birds, and the resulting motion."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from flock_sim.physics.arrays import FloatArray
from flock_sim.physics.compile import kernel
from flock_sim.physics.dynamics import acceleration, circulation_at, drag_of_pair, stage_value


@kernel
def forces(
    position: FloatArray,
    speed: FloatArray,
    coefficients: FloatArray,
    half_span: FloatArray,
    pairs: npt.NDArray[np.int64],
    lateral: FloatArray,
    even: FloatArray,
    circulation: FloatArray,
    drag: FloatArray,
) -> None:
    """Fill `circulation` and `drag`, both (birds, members), pair by pair in ascending order."""
    birds, members = position.shape
    for i in range(birds):
        for m in range(members):
            circulation[i, m] = circulation_at(speed[i, m], coefficients[i, 4, m])
            drag[i, m] = 0.0
    for k in range(pairs.shape[0]):
        i, j = pairs[k, 0], pairs[k, 1]
        for m in range(members):
            on_i, on_j = drag_of_pair(
                position[j, m] - position[i, m],
                lateral[k, m],
                half_span[i, m],
                half_span[j, m],
                even[k, m],
                circulation[i, m],
                circulation[j, m],
            )
            drag[i, m] += on_i
            drag[j, m] += on_j


@kernel
def move(
    stage: int,
    dt: float,
    position: FloatArray,
    speed: FloatArray,
    coefficients: FloatArray,
    drag: FloatArray,
    velocity_slopes: FloatArray,
    speed_slopes: FloatArray,
    position_now: FloatArray,
    speed_now: FloatArray,
) -> None:
    """Compute the slopes at `stage`, and from these the values at the next stage."""
    birds, members = position.shape
    for i in range(birds):
        for m in range(members):
            k = i * members + m
            velocity_slopes[stage, k] = speed_now[i, m]
            speed_slopes[stage, k] = acceleration(
                speed_now[i, m],
                drag[i, m],
                coefficients[i, 0, m],
                coefficients[i, 1, m],
                coefficients[i, 2, m],
                coefficients[i, 3, m],
            )
            position_now[i, m] = stage_value(position[i, m], dt, velocity_slopes, stage + 1, k)
            speed_now[i, m] = stage_value(speed[i, m], dt, speed_slopes, stage + 1, k)
