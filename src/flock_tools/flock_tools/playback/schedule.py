# SPDX-License-Identifier: Apache-2.0
"""The times at which recorded messages are due."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

BILLION = 1_000_000_000


class Schedule:
    """Maps recorded time, in ns, to a monotonic clock, at a rate that can be changed.

    Due times are relative to one anchor, not to the previous message, so delays do not add up.
    Recorded time does not pass `upcoming`, the time of the next message, before it is played. So a
    player that was too slow for a rate does not hurry after a pause or at another rate.
    """

    def __init__(
        self,
        origin: int,
        rate: float = 1.0,
        *,
        paused: bool = False,
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        """Begin at recorded time `origin`. `rate` 0 means as fast as possible. `now` is in s."""
        self._now = now
        self._rate = rate
        self._paused = paused
        self._anchor = (now(), origin)
        self.upcoming: int | None = None
        """Recorded time of the next message, or of the end of the bag, in ns; None: unlimited."""

    @property
    def paused(self) -> bool:
        """Whether recorded time stands still."""
        return self._paused

    @property
    def running(self) -> bool:
        """Whether recorded time runs: neither a pause nor a delay stops it."""
        return not self._paused and self._now() >= self._anchor[0]

    @property
    def rate(self) -> float:
        """Recorded seconds per second; 0: as fast as possible."""
        return self._rate

    @property
    def position(self) -> int:
        """The recorded time reached, in ns."""
        begun, origin = self._anchor
        if self._paused:
            return origin
        reached = origin + round(max(self._now() - begun, 0.0) * self._rate * BILLION)
        return reached if self.upcoming is None else min(reached, self.upcoming)

    def left(self, stamp: int) -> float:
        """Return the time until a message recorded at `stamp` is due, in s; 0 or less: now."""
        if self._paused:
            return math.inf
        begun, origin = self._anchor
        if self._rate == 0.0:
            return max(begun - self._now(), 0.0)
        return begun + (stamp - origin) / (self._rate * BILLION) - self._now()

    def reached(self, stamp: int) -> None:
        """Register a message played without the schedule: in a pause, or at rate 0."""
        if self._paused or self._rate == 0.0:
            self.jump(stamp)

    def jump(self, stamp: int, delay: float = 0.0) -> None:
        """Set the recorded time to `stamp`, where it stands still for `delay` s."""
        self._anchor = (self._now() + delay, stamp)

    def pause(self) -> None:
        """Stop recorded time."""
        self.jump(self.position)
        self._paused = True

    def resume(self) -> None:
        """Continue recorded time from where it stopped."""
        self.jump(self.position)
        self._paused = False

    def set_rate(self, rate: float) -> None:
        """Continue at another rate, after the rest of a delay."""
        self.jump(self.position, max(self._anchor[0] - self._now(), 0.0))
        self._rate = rate
