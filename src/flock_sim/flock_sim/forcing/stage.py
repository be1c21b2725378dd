# SPDX-License-Identifier: Apache-2.0
"""The forcing of one bird at a Runge-Kutta stage: the kernel that birds and the reference share."""

from __future__ import annotations

import numpy as np

from flock_sim.forcing.compiled_law import call
from flock_sim.forcing.frame import (
    BIRD,
    EACH,
    FAULT,
    FAULT_TERM,
    FIRST_TERM,
    FORCE,
    FUNCTION,
    MEMBERS,
    NOISE,
    ORDINAL,
    RAISED,
    RATE,
    SEEDS,
    SLOPES,
    START,
    STATE,
    STATES,
    TERMS,
    matrix,
    vector,
)
from flock_sim.links.counter_rng import gaussians
from flock_sim.physics.arrays import FloatArray, IntArray
from flock_sim.physics.compile import kernel
from flock_sim.physics.dynamics import canonical
from flock_sim.physics.runge_kutta import STAGES, TABLEAU

STEP, INITIAL = 0, 1
"""Purposes of random numbers: those of a step, and those of the initial state."""


@kernel
def normals(seed: int, bird: int, ordinal: int, step: int, purpose: int) -> tuple[float, float]:
    """Return two numbers of the standard normal distribution for a seeded term of a bird.

    The counter is that of a link from the bird to itself, which does not exist.
    """
    return gaussians(seed, bird, bird, step, 2 * ordinal + purpose)


@kernel
def compute_force(words: IntArray, tick: int, dt: float) -> bool:
    """Compute the force of all laws at `tick`, and their states at the next tick.

    `words` are those of `frame`, and NOW and NEAR are filled in. Returns whether all laws are
    sound; a fault is noted in the words. To compute a stage twice has no effect.
    """
    members, rows = words[MEMBERS], words[STATES]
    force = vector(words[FORCE], members)
    for m in range(members):
        force[m] = 0.0
    stage = tick % STAGES
    for term in range(words[TERMS]):
        at = FIRST_TERM + EACH * term
        if stage == 0 and words[at + SEEDS]:
            _draw(words, at, tick // STAGES)
        if not call(words[at + FUNCTION], words.ctypes.data, term, tick, dt):
            words[FAULT], words[FAULT_TERM] = RAISED, term
    if rows:
        now = words[STATE] + 8 * rows * members * (1 - (tick & 1))
        _integrate(
            stage,
            dt,
            vector(words[RATE], rows * members),
            vector(words[START], rows * members),
            vector(words[SLOPES], rows * members),
            vector(now, rows * members),
        )
    return bool(words[FAULT] == 0)


@kernel
def _draw(words: IntArray, at: int, step: int) -> None:
    """Draw the noise of a step for the term whose words are at `at`."""
    members = words[MEMBERS]
    seeds = vector(words[at + SEEDS], members)
    noise = matrix(words[NOISE] + 16 * members * words[at + ORDINAL], 2, members)
    for m in range(members):
        if m == 0 or seeds[m] != seeds[m - 1]:
            one, two = normals(int(seeds[m]), words[BIRD], words[at + ORDINAL], step, STEP)
        noise[0, m], noise[1, m] = one, two


@kernel
def _integrate(
    stage: int, dt: float, rate: FloatArray, start: FloatArray, slopes: FloatArray, now: FloatArray
) -> None:
    """Replace state numbers at `stage` by those at the next stage, as `stage_kernels.move` does.

    At the last stage `start` becomes the state at the beginning of the next step.
    """
    first, last = stage == 0, stage + 1 == STAGES
    step, weight = TABLEAU[stage + 1, stage], TABLEAU[STAGES, stage]
    for i in range(rate.shape[0]):
        slope_sum = (0.0 if first else slopes[i]) + weight * rate[i]
        slopes[i] = slope_sum
        now[i] = canonical(start[i] + dt * (slope_sum if last else step * rate[i]))
        if last:
            start[i] = now[i]


def initial_normals(seeds: FloatArray, bird: int, ordinal: int) -> FloatArray:
    """Return one number of the standard normal distribution for each seed, shape (members,)."""
    return np.array([normals(int(seed), bird, ordinal, 0, INITIAL)[0] for seed in seeds])
