# SPDX-License-Identifier: Apache-2.0
"""Which nodes of a run have reported to the clock, and the step that each has reached."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

from flock_sim.messages.topics import RECORDER
from flock_sim.messages.types import Progress

ABSENT = -2
"""The step of a node that has not reported. -1 is the step of a bird that has reported but has not
heard its neighbours, or of a recorder that has reported but has recorded nothing."""


MOST_INCARNATIONS = 10_000
"""Most incarnations of a node that are remembered: those of its last reports."""

MOST_DOUBTED = 100_000
"""Most reports that are remembered until they are repeated."""


class Attendance:
    """The reports of all nodes in one epoch, and their incarnations in the whole run."""

    def __init__(self, birds: Iterable[str], record: bool) -> None:
        """Expect reports of `birds` and, with `record`, of the recorder."""
        self.recorded = record
        self._birds = tuple(birds)
        self._incarnations: dict[str, dict[int, None]] = {
            name: {} for name in [*self._birds, *([RECORDER] if record else [])]
        }
        self._doubted: set[tuple[str, int, int]] = set()  # reports received once
        self.begin_epoch()

    def begin_epoch(self) -> None:
        """Forget all reports of the epoch before."""
        self.step = ABSENT
        """The step that every bird has reached; below 0 until they have heard each other."""
        self._reached = dict.fromkeys(self._incarnations, ABSENT)
        # Number of birds at each step. It has few entries, however many birds fly.
        self._birds_at = Counter(self._reached[name] for name in self._birds)
        self._heard: set[str] = set()  # since the last move of any node

    def __contains__(self, who: str) -> bool:
        return who in self._incarnations

    def is_new(self, who: str, incarnation: int) -> bool:
        """Whether a node that is known comes back as another incarnation."""
        known = self._incarnations[who]
        return bool(known) and incarnation not in known

    def know(self, who: str, incarnation: int) -> None:
        """Remember the incarnation of a node, as the last one that reported."""
        known = self._incarnations[who]
        known.pop(incarnation, None)
        known[incarnation] = None
        if len(known) > MOST_INCARNATIONS:
            del known[next(iter(known))]

    def reach(self, who: str, step: int) -> bool:
        """Take a report; return whether the node has moved."""
        self._heard.add(who)
        before = self._reached[who]
        if step <= before:
            return False
        self._heard.clear()
        self._reached[who] = step
        if who != RECORDER:
            self._birds_at[step] += 1
            self._birds_at[before] -= 1
            if not self._birds_at[before]:
                del self._birds_at[before]
            self.step = min(self._birds_at)
        return True

    @property
    def begun(self) -> bool:
        """Whether all nodes have reported, and every bird has heard its neighbours."""
        return self.step >= 0 and self._reached.get(RECORDER) != ABSENT

    @property
    def furthest(self) -> int:
        """The step that some bird has reached."""
        return max(self._birds_at)

    @property
    def saved(self) -> int:
        """The last step on disk, -1 or less for none; without a recorder, the step reached."""
        return self._reached.get(RECORDER, self.step)

    def waiting_for(self, granted: int) -> list[str]:
        """Return the nodes that must move before a run granted up to a step can continue."""
        absent = [name for name, step in self._reached.items() if step == ABSENT]
        if absent:
            return absent
        if self.step < max(granted, 1):
            # Waiting birds report every second, so a silent one is the blocker.
            silent = [name for name in self._birds if name not in self._heard]
            behind = [name for name in self._birds if self._reached[name] == self.step]
            return silent if silent and self._heard else behind
        return [RECORDER] if self.recorded else []

    def doubts(self, progress: Progress) -> bool:
        """Whether this report is the first of its kind. A genuine one repeats every second."""
        key = progress.who, progress.life, progress.epoch
        if key in self._doubted:
            return False
        if len(self._doubted) > MOST_DOUBTED:
            self._doubted.clear()
        self._doubted.add(key)
        return True
