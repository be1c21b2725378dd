# SPDX-License-Identifier: Apache-2.0
"""What one bird knows of its neighbours over links that are not plain, and remembers for it."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np

from flock_sim.core.configuration import FlockConfiguration
from flock_sim.core.kernel import FloatArray, IntArray, anew, kernel
from flock_sim.core.links.reception import Hear, hear, hearing
from flock_sim.core.stage_message import FIRST_WORD, stage_words


class Receiver:
    """The links to one bird. `memory` has shape (vectors, members), and is all that it remembers.

    >>> flock = FlockConfiguration(birds=3, links=("hold:delay=5",))
    >>> Receiver(2, flock).memory.shape  # two neighbours: the latest, six on their way; five fields
    (70, 1)
    """

    def __init__(self, bird: int, configuration: FlockConfiguration) -> None:
        """Have heard nothing."""
        members, linkage = configuration.members, configuration.linkage
        self._plan = linkage.plan([bird], members)
        self._slice = slice(*(members * linkage.memory_ends[bird - 1 : bird + 1]))
        self._dt = configuration.dt
        self._known = np.zeros((2, len(self._plan.links), stage_words(members)))
        self._listen = _listening(hearing())
        self.memory = self._plan.memory()

    def begin(self, memory: FloatArray) -> None:
        """Remember what is in `memory`, that of all birds in a row; empty: nothing."""
        if len(memory):
            self.memory = memory[self._slice].reshape(self.memory.shape).copy()
        else:
            self.memory = self._plan.memory()

    def listen(
        self, tick: int, geometry: FloatArray, said: FloatArray, mine: FloatArray
    ) -> FloatArray:
        """Return what is known at `tick`, as stage messages of which the speed is left out.

        `said` has shape (neighbours, words): the messages of this tick where there is an exchange;
        `geometry` and `mine` are those of `feel_and_move`, and so is the result, for this tick.
        """
        self._listen(
            tick,
            self._dt,
            self._plan.links,
            self._plan.faults,
            geometry,
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
    links: IntArray,
    faults: FloatArray,
    geometry: FloatArray,
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
            links[k],
            faults[k],
            geometry[k, 0],
            said[k, position : position + members],
            said[k, speed : speed + members],
            said[k, circulation : circulation + members],
            own,
            memory,
            known[side, k, position : position + members],
            known[side, k, circulation : circulation + members],
        )


@cache
def _listening(heard: Hear) -> Callable[..., None]:
    """Return `_listen` for what `hearing` gives."""
    return _listen if heard is hear else anew(_listen, hear=heard)
