# SPDX-License-Identifier: Apache-2.0
"""How long a node waits, and what it says meanwhile: no wait is silent, none without an end."""

from __future__ import annotations

import time
from collections.abc import Callable

from flock_sim.errors import RunFailed

SAY_AFTER = 10.0
"""Silence, in s, after which it is said what is waited for: half of a timeout that is shorter than
twice that. Processes that are starting are silent for several seconds."""


class Patience:
    """Runs out after `timeout` s in which nothing was heard; says so, through `say`, before."""

    def __init__(self, timeout: float, say: Callable[[str], None]) -> None:
        """Begin to wait."""
        self._timeout = timeout
        self._say = say
        self._said = ""
        self.renew()

    def renew(self) -> None:
        """Something was heard: all the patience is back."""
        self._since = time.monotonic()

    @property
    def silence(self) -> float:
        """Time since anything was heard, in s."""
        return time.monotonic() - self._since

    def wait(self, waiting: Callable[[], str]) -> None:
        """Go on waiting. `waiting` tells who waits for what. Raises RunFailed when it is enough."""
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
            self._say(f"{what}, for {self._timeout - silence:.0f} s more")
