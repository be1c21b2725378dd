# SPDX-License-Identifier: Apache-2.0
"""How fast a flock is flown or played, in steps per second."""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

RATE_OVER = 2.0
"""Time over which the rate is averaged, in s."""


class _Seen(NamedTuple):
    """A step, when it was sent, and when it was seen, in s."""

    step: int
    sent: float
    seen: float


class StepRate:
    """The rate of the steps that are seen.

    Steps may be seen long after they were sent: a late joiner receives the last states of each bird
    at once. So a step counts from the time at which it would have been seen with the delay of the
    last one, if that is earlier.
    """

    def __init__(self) -> None:
        """Start without steps."""
        self._seen: deque[_Seen] = deque()

    def see(self, step: int, sent: float, now: float) -> None:
        """Take the latest step at time `now`; `sent` is when it was sent, both in s."""
        if self._seen and step < self._seen[-1].step:
            self._seen.clear()  # after a rewind or a new playback, the rate starts anew
        self._seen.append(_Seen(step, sent, now))
        while len(self._seen) > 2 and now - self._counts_from(now) > RATE_OVER:
            self._seen.popleft()

    def at(self, now: float) -> float | None:
        """Return the rate, in steps per second; None until two steps are seen."""
        if len(self._seen) < 2:
            return None
        over = now - self._counts_from(now)
        return (self._seen[-1].step - self._seen[0].step) / over if over > 0.0 else None

    def clear(self) -> None:
        """Forget all steps."""
        self._seen.clear()

    def _counts_from(self, now: float) -> float:
        """Return the time from which the first step counts."""
        first, last = self._seen[0], self._seen[-1]
        return min(first.seen, first.sent + now - last.sent)
