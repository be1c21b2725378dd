# SPDX-License-Identifier: Apache-2.0
"""A stopwatch for the work of a process of birds, used only on request.

It wraps the kernel and the birds, so it does not slow a flight without it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from time import perf_counter
from typing import Any

from rclpy.executors import Executor

from flock_sim.console.signals import Stop
from flock_sim.protocol.bird_kernel import StageKernel
from flock_sim.ros.spin import Flier, keep_flying
from flock_sim.ros.time_breakdown import TimeBreakdown
from flock_sim.ros.watchdog import Watchdog


class Stopwatch:
    """Times all birds of one process."""

    def __init__(self) -> None:
        """Start at zero; the time begins with the first stage."""
        self._begun: float | None = None
        self._ended = 0.0
        self._kernel = 0.0
        self._busy = 0.0

    @property
    def times(self) -> TimeBreakdown:
        """The time breakdown from the first stage to the last one so far."""
        if self._begun is None:
            return TimeBreakdown(0.0, 0.0, 0.0)
        waiting = self._ended - self._begun - self._busy
        return TimeBreakdown(self._kernel, self._busy - self._kernel, max(0.0, waiting))

    def around(self, kernel: StageKernel) -> StageKernel:
        """Return `kernel` with time measurement."""

        def timed(*arguments: Any) -> None:
            begun = perf_counter()
            if self._begun is None:
                self._begun = begun
            kernel(*arguments)
            self._ended = perf_counter()
            self._kernel += self._ended - begun

        return timed

    def keep_flying(
        self,
        birds: Sequence[Flier],
        executor: Executor,
        stop: Stop,
        watchdog: Watchdog,
        look_around: Callable[[], bool],
    ) -> None:
        """Call `spin.keep_flying`, and measure the time of all work of the birds."""
        watched = [self.watched(bird) for bird in birds]
        keep_flying(watched, executor, stop, watchdog, lambda: self.fruitful(look_around))

    def watched(self, bird: Flier) -> Flier:
        """Return `bird` with time measurement of all its work."""
        return _Watched(bird, self.fruitful)

    def fruitful(self, work: Callable[[], bool]) -> bool:
        """Do `work`, and count its time if it returns True."""
        begun = perf_counter()
        moved = work()
        if moved and self._begun is not None:
            self._busy += perf_counter() - max(begun, self._begun)
        return moved


class _Watched:
    """A bird whose work is timed."""

    def __init__(self, bird: Flier, fruitful: Callable[[Callable[[], bool]], bool]) -> None:
        self._bird, self._fruitful = bird, fruitful

    def drain(self) -> bool:
        return self._fruitful(self._bird.drain)

    def drain_rare(self) -> bool:
        return self._fruitful(self._bird.drain_rare)

    def report(self) -> None:
        self._bird.report()

    @property
    def finished(self) -> bool:
        return self._bird.finished

    @property
    def waiting_for(self) -> str:
        return self._bird.waiting_for
