# SPDX-License-Identifier: Apache-2.0
"""Rejection warnings: each reason to ignore messages is reported once per process."""

from __future__ import annotations

from collections import Counter

from flock_sim.console.arguments import note
from flock_sim.messages.rejection import AGAIN, STALE


class RejectionWarnings:
    """The rejection warnings of one node, from its counts of ignored messages."""

    def __init__(self, who: str, ignored_for: Counter[str], told: set[str] | None = None) -> None:
        """Warn for node `who`; `told` holds the reasons already reported in its process.

        Stale messages are normal in a recovery, and repeated messages of waiting birds are normal
        after a loss. Neither is reported.
        """
        self._who = who
        self._ignored_for = ignored_for
        self._told = set() if told is None else told
        self._told |= {AGAIN, STALE}

    def tell(self) -> None:
        """Warn of new reasons; the cost is negligible if there are none."""
        if self._ignored_for.keys() <= self._told:
            return
        for reason in self._ignored_for.keys() - self._told:
            self._told.add(reason)
            note(f"warning: {self._who} ignores messages {reason}; /diagnostics counts them")
