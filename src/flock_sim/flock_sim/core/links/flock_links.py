# SPDX-License-Identifier: Apache-2.0
"""All links of a flock at once, for the reference: what every bird feels by what it knows."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np

from flock_sim.core import formation
from flock_sim.core.configuration import FlockConfiguration
from flock_sim.core.flight import circulation_at, drag_of_pair
from flock_sim.core.flock_step import move
from flock_sim.core.kernel import FloatArray, IntArray, anew, kernel
from flock_sim.core.links.linkage import SOURCE, TARGET
from flock_sim.core.links.reception import Hear, hear, hearing
from flock_sim.core.runge_kutta import STAGES


class FlockLinks:
    """The links of a flock and what its birds remember.

    `arrays` are the links (links, 7), by target and source; the pair that each is of (links,);
    the faults (links, 10, members); and the memory (vectors, members). `felt` and `advance` are the
    kernels below, with all models that there are.
    """

    def __init__(self, configuration: FlockConfiguration, members: int) -> None:
        """Have nobody heard anything; `members` may be more than those of the configuration."""
        birds = configuration.birds
        pairs = {pair: k for k, pair in enumerate(formation.pairs(birds, configuration.coupling))}
        plan = configuration.linkage.plan(range(1, birds + 1), members)
        between = [pairs[min(pair), max(pair)] for pair in plan.links[:, [SOURCE, TARGET]].tolist()]
        self.felt, self.advance = _flying(hearing())
        self.arrays = plan.links, np.array(between, dtype=np.int64), plan.faults, plan.memory()


@kernel
def felt(
    tick: int,
    dt: float,
    position: FloatArray,
    speed: FloatArray,
    coefficients: FloatArray,
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
    """Fill `circulation` and `drag`, both (birds, members), with what is felt at `tick`.

    `position` and `speed` (birds, members) are those at its stage, `lateral` and `even`
    (pairs, members) those of a Flock; the memory is that after it.
    """
    birds, members = position.shape
    known_position, known_circulation = np.empty(members), np.empty(members)
    for i in range(birds):
        for m in range(members):
            circulation[i, m] = circulation_at(speed[i, m], coefficients[i, 4, m])
            drag[i, m] = 0.0
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
def advance_over_links(
    position: FloatArray,
    speed: FloatArray,
    dt: float,
    first: int,
    until: int,
    every: int,
    coefficients: FloatArray,
    half_span: FloatArray,
    lateral: FloatArray,
    even: FloatArray,
    links: IntArray,
    pair_of: IntArray,
    faults: FloatArray,
    memory: FloatArray,
    recorded: FloatArray,
) -> None:
    """Take the steps from `first` to below `until` in place, recording multiples of `every`.

    Each bird knows of its neighbours what comes over its links; the arrays are those of `felt`.
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
            felt(
                STAGES * step + stage,
                dt,
                position_now,
                speed_now,
                coefficients,
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
def _flying(heard: Hear) -> tuple[Callable[..., None], Callable[..., None]]:
    """Return `felt` and `advance_over_links` for what `hearing` gives."""
    if heard is hear:
        return felt, advance_over_links
    feel = anew(felt, hear=heard)
    return feel, anew(advance_over_links, felt=feel)
