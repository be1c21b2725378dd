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

    @property
    def paused(self) -> bool:
        """Whether recorded time stands still."""
        return self._paused

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
        return origin + round((self._now() - begun) * self._rate * BILLION)

    def left(self, stamp: int) -> float:
        """Return the time until a message recorded at `stamp` is due, in s; 0 or less: now."""
        if self._paused:
            return math.inf
        if self._rate == 0.0:
            return 0.0
        begun, origin = self._anchor
        return begun + (stamp - origin) / (self._rate * BILLION) - self._now()

    def reached(self, stamp: int) -> None:
        """Register a message played without the schedule: in a pause, or at rate 0."""
        if self._paused or self._rate == 0.0:
            self.jump(stamp)

    def jump(self, stamp: int) -> None:
        """Set the recorded time to `stamp`."""
        self._anchor = (self._now(), stamp)

    def pause(self) -> None:
        """Stop recorded time."""
        self.jump(self.position)
        self._paused = True

    def resume(self) -> None:
        """Continue recorded time from where it stopped."""
        self.jump(self.position)
        self._paused = False

    def set_rate(self, rate: float) -> None:
        """Continue at another rate."""
        self.jump(self.position)
        self._rate = rate
