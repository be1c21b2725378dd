# SPDX-License-Identifier: Apache-2.0
"""The watchdog of a node: every long wait is reported, and every wait has a timeout."""

from __future__ import annotations

import time
from collections.abc import Callable

from flock_sim.errors import RunFailed

LONGEST_LOOK = 1.0
"""Longest time counted between two checks, in s. Nodes check several times a second, so in the time
beyond it the process itself was stopped (Ctrl-Z) or the computer slept."""

SAY_AFTER = 10.0
"""Silence before the first report of a wait, in s; half of the timeout if that is less. Processes
are silent for several seconds while they start."""


class Watchdog:
    """Runs out after `timeout` s without a message; reports the wait before that by `say`."""

    def __init__(self, timeout: float, say: Callable[[str], None]) -> None:
        """Start the inactivity timer."""
        self._timeout = timeout
        self._say = say
        self._said = ""
        self.reset()

    def reset(self) -> None:
        """Reset the inactivity timer."""
        self._looked = time.monotonic()
        self._silence = 0.0

    @property
    def silence(self) -> float:
        """Time since the last reset in which this process ran, in s."""
        now = time.monotonic()
        self._silence += min(now - self._looked, LONGEST_LOOK)
        self._looked = now
        return self._silence

    @property
    def half_elapsed(self) -> bool:
        """Whether half of the timeout has passed."""
        return self.silence >= 0.5 * self._timeout

    def wait(self, waiting: Callable[[], str]) -> None:
        """Continue to wait; `waiting` returns what for, as text. Raises RunFailed at timeout."""
        silence = self.silence
        if silence < min(SAY_AFTER, 0.5 * self._timeout):
            self._said = ""
            return
        what = waiting()
        if silence >= self._timeout:
            raise RunFailed(
                f"no progress for {self._timeout:g} s, {what}: "
                "start what is missing, or raise the timeout"
            )
        if what != self._said:
            self._said = what
            self._say(f"{what} (timeout in {self._timeout - silence:.0f} s)")
