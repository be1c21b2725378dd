# SPDX-License-Identifier: Apache-2.0
"""All links of a flock at once, for the reference: the drags that birds compute from their data."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.links.channel import Hear, hear, hearing
from flock_sim.links.link_table import SOURCE, TARGET
from flock_sim.physics import formation
from flock_sim.physics.arrays import FloatArray, IntArray
from flock_sim.physics.compile import anew, kernel
from flock_sim.physics.dynamics import circulation_at, drag_of_pair
from flock_sim.physics.runge_kutta import STAGES
from flock_sim.reference.flock_kernel import move


class FlockLinks:
    """The links of a flock and the memory of its birds.

    `arrays` are the links (links, 7), ordered by target and source; the index of the pair of each
    link (links,); the faults (links, 10, members); and the memory (vectors, members). `felt` and
    `advance` are the kernels below, with all existing link models.
    """

    def __init__(self, configuration: FlockConfiguration, members: int) -> None:
        """Start before any message; `members` may be more than those of the configuration."""
        birds = configuration.birds
        pairs = {pair: k for k, pair in enumerate(formation.pairs(birds, configuration.coupling))}
        plan = configuration.link_table.plan(range(1, birds + 1), members)
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
    """Fill `circulation` and `drag`, both (birds, members), at `tick`, and update the memory.

    `position` and `speed` (birds, members) are those at the stage of `tick`; `lateral` and `even`
    (pairs, members) are those of a Flock.
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

    Each bird knows its neighbours only by its links. The arrays are those of `felt`.
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
    """Return `felt` and `advance_over_links` for `heard`, the kernel from `hearing`."""
    if heard is hear:
        return felt, advance_over_links
    feel = anew(felt, hear=heard)
    return feel, anew(advance_over_links, felt=feel)
