# SPDX-License-Identifier: Apache-2.0
"""All links of a flock: their settings, the exchanges that they need, and their memory."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from flock_sim.errors import FlockError
from flock_sim.links.exchange_schedule import ExchangeSchedule
from flock_sim.links.keys import FAULTS
from flock_sim.links.settings import FIELDS, PLAIN, SENT, Settings, read
from flock_sim.physics import formation
from flock_sim.physics.arrays import FloatArray, IntArray

# Columns of the plan of links: the birds, the model, the stages that are remembered, the exchanges
# that can be in transit, the steps between exchanges, and the offset of the memory.
SOURCE, TARGET, MODEL, ROWS, SLOTS, INTERVAL, AT = range(7)


@dataclass(frozen=True)
class Plan:
    """Links as kernels read them, those of one or several birds, ordered by target and source."""

    links: IntArray
    """Shape (links, 7): the columns above."""
    faults: FloatArray
    """Shape (links, 10, members): the rows of FAULTS."""
    vectors: int
    """Number of vectors of the memory."""

    def memory(self) -> FloatArray:
        """Return the memory before any message has arrived, shape (vectors, members)."""
        memory = np.zeros((self.vectors, self.faults.shape[2]))
        memory[SENT::FIELDS] = -1.0
        return memory


class LinkTable:
    """The links of a flock of `birds`, set by `entries`. A later entry for a link wins."""

    def __init__(self, entries: Iterable[str], birds: int, coupling: str) -> None:
        """Read the entries. Raises FlockError, which tells the fix."""
        self._birds = birds
        self._coupling = coupling
        self._general = PLAIN
        self._single: dict[tuple[int, int], Settings] = {}
        for entry in entries:
            link, settings = read(entry)
            if link is None:
                self._general, self._single = settings, {}
            else:
                self._check(link, entry)
                self._single[link] = settings
        self.members, self.longest = self._agreed_members()

    @cached_property
    def plain(self) -> bool:
        """Whether every bird has, at every stage, the values of its neighbours at this stage."""
        return all(settings.plain for settings in self.used())

    @cached_property
    def exchange_schedule(self) -> ExchangeSchedule:
        """When the birds exchange messages."""
        used = self.used()
        if not used or any(settings.every_stage for settings in used):
            return ExchangeSchedule()
        return ExchangeSchedule(False, tuple(sorted({settings.interval for settings in used})))

    def of(self, source: int, target: int) -> Settings:
        """Return the settings of the link from `source` to `target`, birds 1..N."""
        return self._single.get((source, target), self._general)

    def plan(self, targets: Iterable[int], members: int) -> Plan:
        """Return the links to birds `targets`, ordered by target and source."""
        links, faults, at = [], [], 0
        for source, target in self._links_to(targets):
            how = self.of(source, target)
            links.append((source, target, how.model, how.rows, how.slots, how.interval, at))
            faults.append(np.broadcast_to(how.faults, (len(FAULTS), members)))
            at += how.vectors
        shape = len(links), len(FAULTS), members
        return Plan(
            np.array(links, dtype=np.int64).reshape(-1, AT + 1),
            np.ascontiguousarray(faults, dtype=np.float64).reshape(shape),
            at,
        )

    @cached_property
    def memory_ends(self) -> IntArray:
        """Ends of the birds' memories, in vectors, when they are joined; shape (birds + 1,).

        The first value is 0, so the memory of bird i lies between values i - 1 and i, counted
        from 0.
        """
        if self.plain:
            return np.zeros(self._birds + 1, dtype=np.int64)
        sizes = np.zeros(self._birds + 1, dtype=np.int64)
        for source, target in self._links_to(range(1, self._birds + 1)):
            sizes[target] += self.of(source, target).vectors
        return np.cumsum(sizes)

    def remembers(self, bird: int) -> int:
        """Return how many vectors a bird remembers; each has one number per member."""
        return int(self.memory_ends[bird] - self.memory_ends[bird - 1])

    def used(self) -> list[Settings]:
        """Return all settings that links of the flock have."""
        neighbours = formation.neighbours
        links = sum(
            len(neighbours(bird, self._birds, self._coupling))
            for bird in (range(1, self._birds + 1) if self._single else ())
        )
        general = self._birds > 1 and (not self._single or links > len(self._single))
        return [*([self._general] if general else []), *self._single.values()]

    def _links_to(self, targets: Iterable[int]) -> Iterator[tuple[int, int]]:
        for target in targets:
            for source in formation.neighbours(target, self._birds, self._coupling):
                yield source, target

    def _check(self, link: tuple[int, int], entry: str) -> None:
        source, target = link
        for bird in link:
            if not 1 <= bird <= self._birds:
                raise FlockError(f"link {entry!r}: bird {bird} is not among 1..{self._birds}")
        around = formation.neighbours(target, self._birds, self._coupling)
        if source not in around:
            raise FlockError(
                f"link {entry!r}: bird {target} does not feel bird {source} with "
                f"{self._coupling} coupling; it feels {', '.join(map(str, around)) or 'no bird'}"
            )

    def _agreed_members(self) -> tuple[int, str]:
        """Return the number of members that the entries have, and the entry that gives it."""
        used = [self._general, *self._single.values()]
        members = max(settings.members for settings in used)
        longest = next(settings for settings in used if settings.members == members)
        for settings in used:
            if settings.members not in (1, members):
                raise FlockError(
                    f"link {settings.text!r} has {settings.members} members and "
                    f"{longest.text!r} has {members}: give 1 or {members} to every link"
                )
        return members, longest.text
