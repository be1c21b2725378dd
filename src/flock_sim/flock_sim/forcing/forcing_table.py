# SPDX-License-Identifier: Apache-2.0
"""All forcing of a flock: the terms of each bird, which add up in the order of the entries."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cached_property

from flock_sim.errors import FlockError
from flock_sim.forcing.settings import Settings, read

MOST_TERMS = 64
"""Most forcing terms of a bird."""


class ForcingTable:
    """The forcing of a flock of `birds`, set by `entries`."""

    def __init__(self, entries: Iterable[str], birds: int) -> None:
        """Read the entries. Raises FlockError, which tells the fix."""
        self._birds = birds
        self.entries = tuple(read(entry) for entry in entries)
        """The terms, in order."""
        for settings in self.entries:
            if settings.bird is not None and not 1 <= settings.bird <= birds:
                raise FlockError(f"{settings.called}: bird {settings.bird} is not among 1..{birds}")
        if len(self.entries) > MOST_TERMS:
            raise FlockError(
                f"forcing has {len(self.entries)} entries: must have {MOST_TERMS} or fewer"
            )
        self.members, self.longest = self._agreed_members()

    @property
    def names(self) -> tuple[str, ...]:
        """The names of all models, each once, in order."""
        return tuple(dict.fromkeys(settings.name for settings in self.entries))

    def of(self, bird: int) -> tuple[Settings, ...]:
        """Return the terms of a bird, 1..N."""
        return tuple(entry for entry in self.entries if entry.bird in (None, bird))

    def check(self) -> None:
        """Raise FlockError if a value is bad, or this process lacks a model or can't compile it."""
        for settings in self.entries:
            settings.check()
        self.states  # noqa: B018  (compiles all laws)

    def state_numbers(self, bird: int) -> int:
        """Return how many numbers the laws of a bird have as their state, in each member."""
        return sum(states_of(settings) for settings in self.of(bird))

    @cached_property
    def states(self) -> int:
        """Number of state numbers of every bird of the flock: the largest of `state_numbers`.

        Compiles the laws. Raises FlockError if this process lacks one, or can't compile it.
        """
        single = {settings.bird for settings in self.entries if settings.bird is not None}
        for_all = sum(states_of(each) for each in self.entries if each.bird is None)
        return max([for_all, *(self.state_numbers(bird) for bird in single)])

    def _agreed_members(self) -> tuple[int, str]:
        """Return the number of members that the entries have, and the entry that gives it."""
        members, longest = 1, ""
        for settings in self.entries:
            if settings.members > 1:
                if members not in (1, settings.members):
                    raise FlockError(
                        f"{settings.called} has {settings.members} members and {longest!r} has "
                        f"{members}: give 1 or {members} to every entry"
                    )
                members, longest = settings.members, settings.text
        return members, longest


def states_of(settings: Settings) -> int:
    """Return the number of state numbers of a term. Raises FlockError, which names the term."""
    # Imported here: a process that only reads a configuration needs no numba.
    import numpy as np

    from flock_sim.forcing.compiled_law import compiled_law

    members = settings.members
    prepared = settings.model.prepare(settings.values(members), 1.0, np.ones(members))
    try:
        return compiled_law(prepared.law).states
    except FlockError as error:
        raise FlockError(f"{settings.called}: {error}") from error
