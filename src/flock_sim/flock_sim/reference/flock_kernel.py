# SPDX-License-Identifier: Apache-2.0
"""The steps of a whole flock: the drags on all birds, over any links, and the resulting motion."""

from __future__ import annotations

import numpy as np

from flock_sim.forcing import frame
from flock_sim.forcing.stage import compute_force
from flock_sim.links.channel import hear
from flock_sim.links.link_table import SOURCE, TARGET
from flock_sim.physics.arrays import FloatArray, IntArray
from flock_sim.physics.compile import kernel
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
    models: IntArray,
    links: IntArray,
    faults: FloatArray,
    memory: FloatArray,
    position: FloatArray,
    speed: FloatArray,
    circulation: FloatArray,
    interactions: FloatArray,
    known: FloatArray,
    drag: FloatArray,
) -> None:
    """Add to `drag`, at `tick`, what each target computes from its link, and update the memory.

    `models` (models,) are the codes of link models. `links`, `faults` and `memory` are those of a
    Plan, `interactions` is the interaction array of its links. `known` (links, 3, members) is
    filled with the position, speed and circulation that each target has of its source. The others
    have shape (birds, members).
    """
    members = position.shape[1]
    for k in range(links.shape[0]):
        known_position, known_circulation = known[k, 0], known[k, 2]
        i, j = links[k, SOURCE] - 1, links[k, TARGET] - 1
        first = k * members
        hear(
            tick,
            dt,
            models,
            links[k],
            faults[k],
            interactions[LATERAL, first : first + members],
            position[i],
            speed[i],
            circulation[i],
            position[j],
            memory,
            known_position,
            known[k, 1],
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
    models: IntArray,
    links: IntArray,
    faults: FloatArray,
    memory: FloatArray,
    interactions: FloatArray,
    known: FloatArray,
    position: FloatArray,
    speed: FloatArray,
    circulation: FloatArray,
    drag: FloatArray,
) -> None:
    """Fill `circulation` and `drag`, both (birds, members), and `known`, at `tick`.

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
            models,
            links,
            faults,
            memory,
            position,
            speed,
            circulation,
            interactions,
            known,
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
    models: IntArray,
    links: IntArray,
    faults: FloatArray,
    memory: FloatArray,
    interactions: FloatArray,
    known: FloatArray,
    forcing: IntArray,
    sums: FloatArray,
    recorded: FloatArray,
    forcing_states: FloatArray,
) -> int:
    """Take the steps from `first` to below `until` in place, recording multiples of `every`.

    `forcing` (birds, words) are the words of the forcing of all birds, without birds if there is
    none. `sums`, shape (2, birds * members), are those of `sum_up`; `recorded` has shape
    (records, 6, birds, members), and `forcing_states` (records, birds, numbers, members); the
    others are as in `forces`. Returns the step in which a law has failed, or -1.
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
                models,
                links,
                faults,
                memory,
                interactions,
                known,
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
                    for i in range(forcing.shape[0]):
                        forcing_states[records, i] = frame.matrix(
                            forcing[i, frame.START],
                            forcing_states.shape[2],
                            forcing_states.shape[3],
                        )
                    records += 1
            if forcing.shape[0] > 0 and not add_forcing(
                STAGES * step + stage,
                dt,
                coefficients,
                links,
                known,
                forcing,
                position_now,
                speed_now,
                circulation,
            ):
                return step
            move(stage, dt, coefficients, present[1], *start, slopes[0], slopes[1], *now)
        for i in range(speed.size):
            start[0][i], start[1][i] = now[0][i], now[1][i]
    return -1


@kernel
def add_forcing(
    tick: int,
    dt: float,
    coefficients: FloatArray,
    links: IntArray,
    known: FloatArray,
    forcing: IntArray,
    position: FloatArray,
    speed: FloatArray,
    circulation: FloatArray,
) -> bool:
    """Set the thrust in `coefficients` of all birds to that without forcing plus their forces.

    The arguments are as in `advance`. Returns whether all laws are sound.
    """
    members = position.shape[1]
    for i in range(forcing.shape[0]):
        words = forcing[i]
        now = frame.matrix(words[frame.NOW], 3, members)
        count = words[frame.NEIGHBOURS]
        near = frame.matrix(words[frame.NEAR], 3 * members, count)
        number = frame.numbers(words[frame.NUMBER], count)
        for m in range(members):
            now[0, m], now[1, m], now[2, m] = position[i, m], speed[i, m], circulation[i, m]
        if words[frame.LOOKS]:
            for k in range(count):
                j, link = number[k] - 1, words[frame.FIRST_LINK] + k
                for m in range(members):
                    if links.shape[0] > 0:
                        for row in range(3):
                            near[row * members + m, k] = known[link, row, m]
                    else:
                        near[m, k], near[members + m, k] = position[j, m], speed[j, m]
                        near[2 * members + m, k] = circulation[j, m]
        if not compute_force(words, tick, dt):
            return False
        thrust = frame.matrix(words[frame.OWN], frame.OWN_ROWS, members)[frame.THRUST]
        force = frame.vector(words[frame.FORCE], members)
        for m in range(members):
            coefficients[frame.THRUST, i * members + m] = thrust[m] + force[m]
    return True
