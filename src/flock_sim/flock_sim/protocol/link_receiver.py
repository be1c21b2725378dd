# SPDX-License-Identifier: Apache-2.0
"""Known values of one bird's neighbours over links that are not plain, and their memory."""

from __future__ import annotations

import numpy as np

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.links.channel import hear
from flock_sim.links.compiled_model import codes
from flock_sim.links.link_table import MODEL
from flock_sim.messages.stage_layout import FIRST_WORD, stage_words
from flock_sim.physics.arrays import FloatArray, IntArray
from flock_sim.physics.compile import kernel
from flock_sim.physics.stage_kernels import LATERAL


class LinkReceiver:
    """The links to one bird. `memory`, shape (vectors, members), is their whole state.

    >>> flock = FlockConfiguration(birds=3, links=("hold:delay=5",))
    >>> LinkReceiver(2, flock).memory.shape  # 2 neighbours: the latest, 6 on their way; 5 fields
    (70, 1)
    """

    def __init__(self, bird: int, configuration: FlockConfiguration) -> None:
        """Start with an empty memory."""
        members, link_table = configuration.members, configuration.link_table
        self._plan = link_table.plan([bird], members)
        self._slice = slice(*(members * link_table.memory_ends[bird - 1 : bird + 1]))
        self._dt = configuration.dt
        self._known = np.zeros((2, len(self._plan.links), stage_words(members)))
        self._models = codes(self._plan.links[:, MODEL])
        self.memory = self._plan.memory()

    def begin(self, memory: FloatArray) -> None:
        """Load the part of this bird from `memory`, that of all birds; if empty, clear it."""
        if len(memory):
            self.memory = memory[self._slice].reshape(self.memory.shape).copy()
        else:
            self.memory = self._plan.memory()

    def listen(
        self, tick: int, interactions: FloatArray, said: FloatArray, mine: FloatArray
    ) -> FloatArray:
        """Return the known values at `tick`, as stage messages.

        `said` has shape (neighbours, words): the messages of this tick if it has an exchange.
        `interactions` and `mine` are as in `feel_and_move`; the result is its `heard` at this tick.
        """
        _listen(
            tick,
            self._dt,
            self._models,
            self._plan.links,
            self._plan.faults,
            interactions,
            said,
            mine,
            self.memory,
            self._known,
        )
        return self._known


@kernel
def _listen(
    tick: int,
    dt: float,
    models: IntArray,
    links: IntArray,
    faults: FloatArray,
    interactions: FloatArray,
    said: FloatArray,
    mine: FloatArray,
    memory: FloatArray,
    known: FloatArray,
) -> None:
    members = memory.shape[1]
    side = tick & 1
    position = FIRST_WORD
    speed = FIRST_WORD + members + 1
    circulation = FIRST_WORD + 2 * (members + 1)
    own = mine[side, position : position + members]
    for k in range(links.shape[0]):
        hear(
            tick,
            dt,
            models,
            links[k],
            faults[k],
            interactions[LATERAL, k * members : (k + 1) * members],
            said[k, position : position + members],
            said[k, speed : speed + members],
            said[k, circulation : circulation + members],
            own,
            memory,
            known[side, k, position : position + members],
            known[side, k, speed : speed + members],
            known[side, k, circulation : circulation + members],
        )
