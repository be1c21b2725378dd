# SPDX-License-Identifier: Apache-2.0
"""The steps of a whole flock: the drags on all birds, over any links, and the resulting motion."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np

from flock_sim.links.channel import Hear, hear
from flock_sim.links.link_table import SOURCE, TARGET
from flock_sim.physics.arrays import FloatArray, IntArray
from flock_sim.physics.compile import anew, kernel
from flock_sim.physics.dynamics import acceleration, circulation_at, drag_of_pair, stage_value
from flock_sim.physics.runge_kutta import STAGES


@kernel
def forces(
    position: FloatArray,
    speed: FloatArray,
    coefficients: FloatArray,
    half_span: FloatArray,
    pairs: IntArray,
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


@kernel
def add_forces_over_links(
    tick: int,
    dt: float,
    position: FloatArray,
    speed: FloatArray,
    half_span: FloatArray,
    lateral: FloatArray,
    even: FloatArray,
    links: IntArray,
    pair_of: IntArray,
    faults: FloatArray,
    memory: FloatArray,
    circulation: FloatArray,
    drag: FloatArray,
) -> None:
    """Add to `drag`, at `tick`, what each target computes from its link, and update the memory.

    `pair_of` (links,) has the pair of each link; `links`, `faults` and `memory` are those of a
    Plan. The other arrays are those of `forces`, at the stage of `tick`.
    """
    members = position.shape[1]
    known_position, known_circulation = np.empty(members), np.empty(members)
    for k in range(links.shape[0]):
        i, j, pair = links[k, SOURCE] - 1, links[k, TARGET] - 1, pair_of[k]
        hear(
            tick,
            dt,
            links[k],
            faults[k],
            lateral[pair],
            position[i],
            speed[i],
            circulation[i],
            position[j],
            memory,
            known_position,
            known_circulation,
        )
        for m in range(members):
            on_j, _ = drag_of_pair(
                known_position[m] - position[j, m],
                lateral[pair, m],
                half_span[j, m],
                half_span[i, m],
                even[pair, m],
                circulation[j, m],
                known_circulation[m],
            )
            drag[j, m] += on_j


@kernel
def advance(
    position: FloatArray,
    speed: FloatArray,
    dt: float,
    first: int,
    until: int,
    every: int,
    coefficients: FloatArray,
    half_span: FloatArray,
    pairs: IntArray,
    lateral: FloatArray,
    even: FloatArray,
    links: IntArray,
    pair_of: IntArray,
    faults: FloatArray,
    memory: FloatArray,
    recorded: FloatArray,
) -> None:
    """Take the steps from `first` to below `until` in place, recording multiples of `every`.

    The birds of `pairs` have each other's present values, others what `links` transmit.
    `recorded` has shape (records, 4, birds, members).
    """
    position_now = position.copy()
    speed_now = speed.copy()
    circulation = np.empty_like(speed)
    drag = np.empty_like(speed)
    velocity_slopes = np.empty((STAGES, position.size))
    speed_slopes = np.empty((STAGES, position.size))

    records = 0
    for step in range(first, until):
        for stage in range(STAGES):
            forces(
                position_now,
                speed_now,
                coefficients,
                half_span,
                pairs,
                lateral,
                even,
                circulation,
                drag,
            )
            if links.shape[0] > 0:
                add_forces_over_links(
                    STAGES * step + stage,
                    dt,
                    position_now,
                    speed_now,
                    half_span,
                    lateral,
                    even,
                    links,
                    pair_of,
                    faults,
                    memory,
                    circulation,
                    drag,
                )
            if stage == 0 and step % every == 0:
                row = recorded[records]
                records += 1
                row[0], row[1], row[2], row[3] = position, speed, circulation, drag
            move(
                stage,
                dt,
                position,
                speed,
                coefficients,
                drag,
                velocity_slopes,
                speed_slopes,
                position_now,
                speed_now,
            )
        position[:] = position_now
        speed[:] = speed_now


@cache
def flying(heard: Hear) -> tuple[Callable[..., None], Callable[..., None]]:
    """Return `add_forces_over_links` and `advance` for `heard`, `hear` or that of `hearing`."""
    if heard is hear:
        return add_forces_over_links, advance
    add = anew(add_forces_over_links, hear=heard)
    return add, anew(advance, add_forces_over_links=add)
