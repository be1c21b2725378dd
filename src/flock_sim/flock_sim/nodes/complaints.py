# SPDX-License-Identifier: Apache-2.0
"""What nodes say of messages that they ignore: each reason once in a process."""

from __future__ import annotations

from collections import Counter

from flock_sim.command_line import note
from flock_sim.core.stage_inbox import AGAIN, STALE


class Complaints:
    """Looks at the counts of ignored messages of one node, and warns of each reason once."""

    def __init__(self, who: str, ignored_for: Counter[str], told: set[str] | None = None) -> None:
        """Speak for `who`; `told` are the reasons that others of its process have told already.

        That messages go stale is how a flock recovers, and that birds which wait repeat what they
        said is how it gets over a loss: neither is told.
        """
        self._who = who
        self._ignored_for = ignored_for
        self._told = set() if told is None else told
        self._told |= {AGAIN, STALE}

    def tell(self) -> None:
        """Warn of reasons that are new; costs next to nothing where there are none."""
        if self._ignored_for.keys() <= self._told:
            return
        for reason in self._ignored_for.keys() - self._told:
            self._told.add(reason)
            note(f"warning: {self._who} ignores messages {reason}; /diagnostics counts them")
