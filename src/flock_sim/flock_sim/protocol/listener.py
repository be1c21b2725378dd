# SPDX-License-Identifier: Apache-2.0
"""Common part of birds in lockstep and in free flight: grants and ignored messages."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

from flock_sim.messages.epochs import NEVER
from flock_sim.messages.types import Grant
from flock_sim.protocol.neighbours import Neighbourhood
from flock_sim.protocol.session import Session

if TYPE_CHECKING:
    from flock_sim.protocol.bird import Outgoing


class Listener:
    """A bird among its neighbours."""

    _around: Neighbourhood
    _session: Session
    ignored: int
    """Number of ignored messages."""
    ignored_for: Counter[str]
    """Number of ignored messages, by reason."""

    @property
    def neighbours(self) -> tuple[int, ...]:
        """The birds whose messages this bird receives."""
        return self._around.birds

    def ignore(self, reason: str) -> list[Outgoing]:
        """Count an ignored message."""
        self.ignored += 1
        self.ignored_for[reason] += 1
        return []

    def receive_grant(self, grant: Grant) -> list[Outgoing]:
        """Begin the grant's epoch, or continue the present one as far as the grant allows.

        Raises FlockError if the first grant is of another flight, and RunFailed if a new epoch
        begins while a free flight is in progress.
        """
        session = self._session
        if reason := session.refuses_grant(grant):
            return self.ignore(reason)
        first = session.epoch == NEVER
        return self._join(grant, first) if session.take_grant(grant) else self._extend(grant)

    def _join(self, grant: Grant, first: bool) -> list[Outgoing]:
        """Begin the grant's epoch; `first`: no epoch was known before."""
        raise NotImplementedError

    def _extend(self, grant: Grant) -> list[Outgoing]:
        """Continue the present epoch as far as the grant allows."""
        raise NotImplementedError
