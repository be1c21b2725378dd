# SPDX-License-Identifier: Apache-2.0
"""How messages come over a link, and what is known by them: kernels of bird and reference alike.

What is remembered of a link are vectors of one number a member: of each slot, each stage and each
field one. Slot 0 is the latest message that has arrived; in the others are those on their way, each
from the moment at which it is sent: whether it will arrive, when, and with what values is known
then. So nothing of this depends on when or in which order messages travel in truth.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache

import numpy as np

from flock_sim.core.kernel import FloatArray, IntArray, anew, kernel
from flock_sim.core.links.chance import FATE, NOISE, gaussians, uniforms
from flock_sim.core.links.linkage import AT, INTERVAL, MODEL, ROWS, SLOTS, SOURCE, TARGET
from flock_sim.core.links.model import LinkModel
from flock_sim.core.links.registry import BUILT_IN, MODELS, choice, know
from flock_sim.core.links.settings import (
    ARRIVAL,
    CIRCULATION,
    DELAY,
    DROP,
    FIELDS,
    JITTER,
    POSITION,
    POSITION_NOISE,
    POSITION_QUANTUM,
    RANGE,
    RATE,
    SEED,
    SENT,
    SPEED,
    SPEED_NOISE,
    SPEED_QUANTUM,
    TIMEOUT,
)
from flock_sim.core.runge_kutta import NODES, STAGES

Hear = Callable[..., None]
"""What `hear` takes, and gives."""


@kernel
def hear(
    tick: int,
    dt: float,
    link: IntArray,
    faults: FloatArray,
    lateral: FloatArray,
    position: FloatArray,
    speed: FloatArray,
    circulation: FloatArray,
    own_position: FloatArray,
    memory: FloatArray,
    known_position: FloatArray,
    known_circulation: FloatArray,
) -> None:
    """Take what the source of `link` sends at `tick`, and fill what the target knows of it then.

    `link` (7,) and `faults` (10, members) are of a Plan, `memory` (vectors, members) is of all its
    links; all others have shape (members,): the lateral distance, what the source says now (read
    where an exchange of the link is due), the target's own position, and the result.
    Who is not known at all has circulation 0, and so causes no drag.
    """
    step, stage = tick // STAGES, tick % STAGES
    rows = link[ROWS]
    if rows == 0:
        known_position[:] = position
        known_circulation[:] = circulation
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
            known_position[m] = known_circulation[m] = 0.0
        else:
            known_position[m], known_circulation[m] = know(
                link[MODEL],
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
    """Decide for each member whether what is sent at `step` will arrive, and when."""
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
    """Put what is sent at `stage` into its slot, as it will arrive."""
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
        memory[at + POSITION, m] = x
        memory[at + SPEED, m] = u
        if _speed_is_altered(faults, m):
            # Gamma is proportional to 1 / U: what is heard of it goes with what is heard of U.
            memory[at + CIRCULATION, m] = circulation[m] * speed[m] / u
        else:
            memory[at + CIRCULATION, m] = circulation[m]


@kernel
def _arrive(
    step: int, stage: int, dt: float, link: IntArray, faults: FloatArray, memory: FloatArray
) -> None:
    """Make of all that has arrived by `step` what was sent last the latest."""
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
        memory[latest + RATE, m] = rate


@kernel
def _speed_is_altered(faults: FloatArray, m: int) -> bool:
    return bool(faults[SPEED_NOISE, m] > 0.0 or faults[SPEED_QUANTUM, m] > 0.0)


def hearing() -> Hear:
    """Return `hear` with all models that there are: the kernel itself, where none is registered."""
    return _hearing(tuple(MODELS)) if len(MODELS) > BUILT_IN else hear


@cache
def _hearing(models: tuple[LinkModel, ...]) -> Hear:
    return anew(hear, know=choice(models))
