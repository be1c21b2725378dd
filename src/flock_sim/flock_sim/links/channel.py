# SPDX-License-Identifier: Apache-2.0
"""Transmission over a link: the kernels that both the birds and the reference use.

The memory of a link consists of vectors with one number per member: one vector for each slot, stage
and field. Slot 0 holds the latest message that has arrived. The other slots hold the messages in
transit. When a message is sent, it is decided whether it will arrive, when, and with what values.
So the result does not depend on when and in which order the real messages travel.
"""

from __future__ import annotations

import math

import numpy as np

from flock_sim.links.compiled_model import perceive
from flock_sim.links.counter_rng import FATE, NOISE, gaussians, uniforms
from flock_sim.links.keys import (
    DELAY,
    DROP,
    JITTER,
    POSITION_NOISE,
    POSITION_QUANTUM,
    RANGE,
    SEED,
    SPEED_NOISE,
    SPEED_QUANTUM,
    TIMEOUT,
)
from flock_sim.links.link_table import AT, INTERVAL, MODEL, ROWS, SLOTS, SOURCE, TARGET
from flock_sim.links.settings import (
    ARRIVAL,
    CIRCULATION,
    FIELDS,
    POSITION,
    RATE,
    SENT,
    SPEED,
)
from flock_sim.physics.arrays import FloatArray, IntArray
from flock_sim.physics.compile import kernel
from flock_sim.physics.dynamics import canonical
from flock_sim.physics.runge_kutta import NODES, STAGES


@kernel
def hear(
    tick: int,
    dt: float,
    models: IntArray,
    link: IntArray,
    faults: FloatArray,
    lateral: FloatArray,
    position: FloatArray,
    speed: FloatArray,
    circulation: FloatArray,
    own_position: FloatArray,
    memory: FloatArray,
    known_position: FloatArray,
    known_speed: FloatArray,
    known_circulation: FloatArray,
) -> None:
    """Receive what the source of `link` sends at `tick`, and fill what the target knows of it.

    `models` (models,) are the codes of link models. `link` (7,) and `faults` (10, members) are rows
    of a Plan, `memory` (vectors, members) is that of all its links. All others have shape
    (members,): the lateral distance, the present values of the source (read if an exchange of the
    link is due), the target's own position, and the result. The known speed is that of the latest
    message. An unknown source has circulation 0, so it causes no drag.
    """
    step, stage = tick // STAGES, tick % STAGES
    rows = link[ROWS]
    if rows == 0:
        for m in range(known_position.shape[0]):
            known_position[m], known_circulation[m] = position[m], circulation[m]
            known_speed[m] = speed[m]
        return
    if stage < rows:
        if step % link[INTERVAL] == 0:
            slot = 1 + (step // link[INTERVAL]) % link[SLOTS]
            if stage == 0:
                _decide(step, slot, link, faults, lateral, position, own_position, memory)
            _take(step, stage, slot, link, faults, position, speed, circulation, memory)
        _arrive(step, stage, dt, link, faults, memory)

    at = link[AT] + min(stage, rows - 1) * FIELDS
    for m in range(known_position.shape[0]):
        age = step - memory[at + SENT, m]
        if memory[at + SENT, m] < 0.0 or age > faults[TIMEOUT, m]:
            known_position[m] = known_speed[m] = known_circulation[m] = 0.0
        else:
            known_speed[m] = memory[at + SPEED, m]
            known_position[m], known_circulation[m] = perceive(
                models[link[MODEL]],
                (age + NODES[stage]) * dt,
                memory[at + POSITION, m],
                memory[at + SPEED, m],
                memory[at + CIRCULATION, m],
                memory[at + RATE, m],
            )


@kernel
def _decide(
    step: int,
    slot: int,
    link: IntArray,
    faults: FloatArray,
    lateral: FloatArray,
    position: FloatArray,
    own_position: FloatArray,
    memory: FloatArray,
) -> None:
    """Decide for each member whether the message sent at `step` will arrive, and when."""
    at = link[AT] + slot * link[ROWS] * FIELDS
    luck, lateness = 0.0, 0.0
    for m in range(position.shape[0]):
        if m == 0 or faults[SEED, m] != faults[SEED, m - 1]:
            luck, lateness = uniforms(int(faults[SEED, m]), link[SOURCE], link[TARGET], step, FATE)
        lost = luck < faults[DROP, m]
        if faults[RANGE, m] < np.inf:
            x = position[m] - own_position[m]
            lost |= not math.sqrt(x * x + lateral[m] * lateral[m]) <= faults[RANGE, m]
        memory[at + SENT, m] = -1.0 if lost else step
        jitter = math.floor(lateness * (faults[JITTER, m] + 1.0))
        memory[at + ARRIVAL, m] = step + faults[DELAY, m] + jitter


@kernel
def _take(
    step: int,
    stage: int,
    slot: int,
    link: IntArray,
    faults: FloatArray,
    position: FloatArray,
    speed: FloatArray,
    circulation: FloatArray,
    memory: FloatArray,
) -> None:
    """Store the message sent at `stage` in its slot, with the values that will arrive."""
    first = link[AT] + slot * link[ROWS] * FIELDS
    at = first + stage * FIELDS
    position_noise, speed_noise = 0.0, 0.0
    drawn = -1.0  # the seed that the noise was drawn with
    for m in range(position.shape[0]):
        memory[at + SENT, m] = memory[first + SENT, m]
        memory[at + ARRIVAL, m] = memory[first + ARRIVAL, m]
        x, u = position[m], speed[m]
        noisy = faults[POSITION_NOISE, m] > 0.0 or faults[SPEED_NOISE, m] > 0.0
        if noisy and faults[SEED, m] != drawn:
            drawn = faults[SEED, m]
            position_noise, speed_noise = gaussians(
                int(drawn), link[SOURCE], link[TARGET], step, NOISE + stage
            )
        if faults[POSITION_NOISE, m] > 0.0:
            x += faults[POSITION_NOISE, m] * position_noise
        if faults[SPEED_NOISE, m] > 0.0:
            u += faults[SPEED_NOISE, m] * speed_noise
        if faults[POSITION_QUANTUM, m] > 0.0:
            x = np.rint(x / faults[POSITION_QUANTUM, m]) * faults[POSITION_QUANTUM, m]
        if faults[SPEED_QUANTUM, m] > 0.0:
            u = np.rint(u / faults[SPEED_QUANTUM, m]) * faults[SPEED_QUANTUM, m]
        memory[at + POSITION, m] = canonical(x)
        memory[at + SPEED, m] = canonical(u)
        if _speed_is_altered(faults, m):
            # Gamma is proportional to 1 / U: the received Gamma must fit the received U.
            memory[at + CIRCULATION, m] = canonical(circulation[m] * speed[m] / u)
        else:
            memory[at + CIRCULATION, m] = canonical(circulation[m])


@kernel
def _arrive(
    step: int, stage: int, dt: float, link: IntArray, faults: FloatArray, memory: FloatArray
) -> None:
    """Of the messages that have arrived by `step`, make the one sent last the latest."""
    latest = link[AT] + stage * FIELDS
    for m in range(memory.shape[1]):
        newest, sent = latest, memory[latest + SENT, m]
        for slot in range(1, link[SLOTS] + 1):
            at = latest + slot * link[ROWS] * FIELDS
            if memory[at + ARRIVAL, m] <= step and memory[at + SENT, m] > sent:
                newest, sent = at, memory[at + SENT, m]
        if newest == latest:
            continue
        rate = 0.0
        if memory[latest + SENT, m] >= 0.0 and not _speed_is_altered(faults, m):
            change = memory[newest + CIRCULATION, m] - memory[latest + CIRCULATION, m]
            rate = change / ((sent - memory[latest + SENT, m]) * dt)
        for field in range(FIELDS):
            memory[latest + field, m] = memory[newest + field, m]
        memory[latest + RATE, m] = canonical(rate)


@kernel
def _speed_is_altered(faults: FloatArray, m: int) -> bool:
    return bool(faults[SPEED_NOISE, m] > 0.0 or faults[SPEED_QUANTUM, m] > 0.0)
