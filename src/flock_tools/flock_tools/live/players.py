# SPDX-License-Identifier: Apache-2.0
"""Which nodes play a recorded flight, what they publish, and since when they do."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from typing import NamedTuple

from flock_sim.messages.topics import bird_name


class Publisher(NamedTuple):
    """A node that publishes a topic."""

    node: str
    """Its name, with its namespace; empty while it has not been discovered."""
    participant: tuple[int, ...]
    """Its process on the network: another player of the same name has another one."""


class Players:
    """The nodes that publish states of birds and are not these birds: they play recorded flights.

    Recorded states do not tell the run that they are of. So the player tells which grants and wings
    belong to them: those that it publishes itself.
    """

    def __init__(self) -> None:
        """Start without players. Everything that is received belongs together, until one is met."""
        self.birds: frozenset[int] = frozenset()
        """The birds whose states are played."""
        self.grant = True
        """Whether they publish grants, too."""
        self.clock = True
        """Whether a node that is none of them publishes grants."""
        self._players: frozenset[Publisher] = frozenset()
        self._since: dict[tuple[int, ...], float] = {}
        self._looked = -math.inf

    @property
    def since(self) -> float:
        """The time before the last player came, in s: earlier messages are not its messages."""
        return max((self._since[each.participant] for each in self._players), default=-math.inf)

    def look(
        self,
        states: Mapping[int, Collection[Publisher]],
        grants: Collection[Publisher],
        now: float,
    ) -> None:
        """Take the publishers of each bird's states and of grants at time `now`, in s.

        The last players stay the players until others come.
        """
        played = {
            bird: {
                each for each in found if each.node.rpartition("/")[2] not in ("", bird_name(bird))
            }
            for bird, found in states.items()
        }
        if players := frozenset(each for found in played.values() for each in found):
            self._players = players
            self.birds = frozenset(bird for bird, found in played.items() if found)
            self.grant = not players.isdisjoint(grants)
        self.clock = not self._players.issuperset(grants)
        present = {each.participant for found in (*states.values(), grants) for each in found}
        present |= {each.participant for each in self._players}
        self._since = {each: self._since.get(each, self._looked) for each in present}
        self._looked = now
