# SPDX-License-Identifier: Apache-2.0
"""What birds have in common however they fly: whom they hear, and what of it they ignore."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

from flock_sim.core.neighbourhood import Neighbourhood

if TYPE_CHECKING:
    from flock_sim.core.protocol import Outgoing


class Listener:
    """A bird among its neighbours."""

    _around: Neighbourhood
    ignored: int
    """How many messages changed nothing."""
    ignored_for: Counter[str]
    """How many messages changed nothing, by the reason."""

    @property
    def neighbours(self) -> tuple[int, ...]:
        """The birds whose messages it hears."""
        return self._around.birds

    def ignore(self, reason: str) -> list[Outgoing]:
        """Count a message that changes nothing."""
        self.ignored += 1
        self.ignored_for[reason] += 1
        return []
