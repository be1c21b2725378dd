# SPDX-License-Identifier: Apache-2.0
"""When recorded messages are due to be played."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

BILLION = 1_000_000_000


class Schedule:
    """Maps recorded time, in ns, to that of a monotonic clock, at a rate that can be changed.

    What is due is reckoned from one anchor, not from the message before: delays do not add up.
    """

    def __init__(
        self,
        origin: int,
        rate: float = 1.0,
        *,
        paused: bool = False,
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        """Begin at recorded time `origin`; `rate` 0: as fast as can be. `now` is in s."""
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
        """Recorded seconds in a second; 0: as fast as can be."""
        return self._rate

    @property
    def position(self) -> int:
        """The recorded time that is reached, in ns."""
        begun, origin = self._anchor
        if self._paused:
            return origin
        return origin + round((self._now() - begun) * self._rate * BILLION)

    def left(self, stamp: int) -> float:
        """Return how long, in s, until what was recorded at `stamp` is due; not above 0: now."""
        if self._paused:
            return math.inf
        if self._rate == 0.0:
            return 0.0
        begun, origin = self._anchor
        return begun + (stamp - origin) / (self._rate * BILLION) - self._now()

    def reached(self, stamp: int) -> None:
        """Take note of what was played without the schedule: in a pause, or as fast as can be."""
        if self._paused or self._rate == 0.0:
            self.jump(stamp)

    def jump(self, stamp: int) -> None:
        """Be at recorded time `stamp`."""
        self._anchor = (self._now(), stamp)

    def pause(self) -> None:
        """Let recorded time stand still."""
        self.jump(self.position)
        self._paused = True

    def resume(self) -> None:
        """Let it go on, from where it stands."""
        self.jump(self.position)
        self._paused = False

    def set_rate(self, rate: float) -> None:
        """Go on at another rate from here."""
        self.jump(self.position)
        self._rate = rate
