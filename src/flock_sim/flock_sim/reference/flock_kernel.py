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
from flock_sim.physics.dynamics import canonical, circulation_at
from flock_sim.physics.runge_kutta import STAGES
from flock_sim.physics.stage_kernels import (
    CIRCULATION,
    DISTANCE,
    LATERAL,
    ON_BIRD,
    ON_OTHER,
    OTHER_CIRCULATION,
    compute_drags,
    move,
    sum_up,
)

RECORDED = 6
"""Number of recorded quantities of a bird, which are the ARRAYS of a state, in this order."""


@kernel
def fill_circulation(speed: FloatArray, coefficient: FloatArray, circulation: FloatArray) -> None:
    """Fill `circulation`; all arrays have shape (birds * members,)."""
    for i in range(speed.shape[0]):
        circulation[i] = circulation_at(speed[i], coefficient[i])


@kernel
def add_forces(
    pairs: IntArray,
    position: FloatArray,
    circulation: FloatArray,
    interactions: FloatArray,
    drag: FloatArray,
) -> None:
    """Add the drags of `pairs` (pairs, 2) to `drag`, pair by pair in ascending order.

    `interactions` is their interaction array; the others have shape (birds, members).
    """
    members = position.shape[1]
    for k in range(pairs.shape[0]):
        i, j = pairs[k, 0], pairs[k, 1]
        for m in range(members):
            at = k * members + m
            interactions[DISTANCE, at] = position[j, m] - position[i, m]
            interactions[CIRCULATION, at] = circulation[i, m]
            interactions[OTHER_CIRCULATION, at] = circulation[j, m]
    compute_drags(interactions)
    for k in range(pairs.shape[0]):
        i, j = pairs[k, 0], pairs[k, 1]
        for m in range(members):
            at = k * members + m
            drag[i, m] = canonical(drag[i, m] + interactions[ON_BIRD, at])
            drag[j, m] = canonical(drag[j, m] + interactions[ON_OTHER, at])


@kernel
def add_forces_over_links(
    tick: int,
    dt: float,
    links: IntArray,
    faults: FloatArray,
    memory: FloatArray,
    position: FloatArray,
    speed: FloatArray,
    circulation: FloatArray,
    interactions: FloatArray,
    drag: FloatArray,
) -> None:
    """Add to `drag`, at `tick`, what each target computes from its link, and update the memory.

    `links`, `faults` and `memory` are those of a Plan, `interactions` is the interaction array of
    its links. The others have shape (birds, members).
    """
    members = position.shape[1]
    known_position, known_circulation = np.empty(members), np.empty(members)
    for k in range(links.shape[0]):
        i, j = links[k, SOURCE] - 1, links[k, TARGET] - 1
        first = k * members
        hear(
            tick,
            dt,
            links[k],
            faults[k],
            interactions[LATERAL, first : first + members],
            position[i],
            speed[i],
            circulation[i],
            position[j],
            memory,
            known_position,
            known_circulation,
        )
        for m in range(members):
            interactions[DISTANCE, first + m] = known_position[m] - position[j, m]
            interactions[CIRCULATION, first + m] = circulation[j, m]
            interactions[OTHER_CIRCULATION, first + m] = known_circulation[m]
    compute_drags(interactions)
    for k in range(links.shape[0]):
        j = links[k, TARGET] - 1
        for m in range(members):
            drag[j, m] = canonical(drag[j, m] + interactions[ON_BIRD, k * members + m])


@kernel
def forces(
    tick: int,
    dt: float,
    coefficients: FloatArray,
    pairs: IntArray,
    links: IntArray,
    faults: FloatArray,
    memory: FloatArray,
    interactions: FloatArray,
    position: FloatArray,
    speed: FloatArray,
    circulation: FloatArray,
    drag: FloatArray,
) -> None:
    """Fill `circulation` and `drag`, both (birds, members), at `tick`.

    The birds of `pairs` have each other's present values, others what `links` transmit: one of the
    two is empty, and `interactions` are those of the other. `coefficients` has shape
    (5, birds * members).
    """
    fill_circulation(speed.reshape(-1), coefficients[4], circulation.reshape(-1))
    drag.fill(0.0)
    if links.shape[0] > 0:
        add_forces_over_links(
            tick,
            dt,
            links,
            faults,
            memory,
            position,
            speed,
            circulation,
            interactions,
            drag,
        )
    else:
        add_forces(pairs, position, circulation, interactions, drag)


@kernel
def record(
    position: FloatArray,
    speed: FloatArray,
    circulation: FloatArray,
    drag: FloatArray,
    sums: FloatArray,
    averaged: int,
    recorded: FloatArray,
) -> None:
    """Fill `recorded`, shape (6, birds * members); the others have shape (birds * members,).

    `sums`, shape (2, birds * members), are those of `sum_up`, over as many steps as `averaged`.
    """
    for i in range(position.shape[0]):
        recorded[0, i], recorded[1, i] = position[i], speed[i]
        recorded[2, i], recorded[3, i] = circulation[i], drag[i]
        recorded[4, i], recorded[5, i] = sums[0, i] / averaged, sums[1, i] / averaged


@kernel
def advance(
    position: FloatArray,
    speed: FloatArray,
    dt: float,
    first: int,
    until: int,
    every: int,
    coefficients: FloatArray,
    pairs: IntArray,
    links: IntArray,
    faults: FloatArray,
    memory: FloatArray,
    interactions: FloatArray,
    sums: FloatArray,
    recorded: FloatArray,
) -> None:
    """Take the steps from `first` to below `until` in place, recording multiples of `every`.

    `sums`, shape (2, birds * members), are those of `sum_up`; `recorded` has shape
    (records, 6, birds, members); the others are as in `forces`.
    """
    position_now, speed_now = position.copy(), speed.copy()
    circulation, drag = np.empty_like(speed), np.empty_like(speed)
    slopes = np.empty((2, speed.size))
    start = position.reshape(-1), speed.reshape(-1)
    now = position_now.reshape(-1), speed_now.reshape(-1)
    present = circulation.reshape(-1), drag.reshape(-1)

    records = 0
    for step in range(first, until):
        for stage in range(STAGES):
            forces(
                STAGES * step + stage,
                dt,
                coefficients,
                pairs,
                links,
                faults,
                memory,
                interactions,
                position_now,
                speed_now,
                circulation,
                drag,
            )
            if stage == 0:
                sum_up(step, every, start[1], present[1], sums[0], sums[1])
                if step % every == 0:
                    averaged = every if step else 1
                    row = recorded[records].reshape(RECORDED, -1)
                    record(*start, *present, sums, averaged, row)
                    records += 1
            move(stage, dt, coefficients, present[1], *start, slopes[0], slopes[1], *now)
        for i in range(speed.size):
            start[0][i], start[1][i] = now[0][i], now[1][i]


@cache
def flying(heard: Hear) -> tuple[Callable[..., None], Callable[..., None]]:
    """Return `forces` and `advance` for `heard`, which is `hear` or the result of `hearing`."""
    if heard is hear:
        return forces, advance
    over_links = anew(add_forces_over_links, hear=heard)
    all_forces = anew(forces, add_forces_over_links=over_links)
    return all_forces, anew(advance, forces=all_forces)
