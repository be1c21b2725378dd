# SPDX-License-Identifier: Apache-2.0
"""A stopwatch around what a process of birds does, for flights in which somebody asks for it.

It wraps the kernel and the birds: a flight that nobody times is not slowed by it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from time import perf_counter
from typing import Any

from rclpy.executors import Executor

from flock_sim.core.bird_step import StageKernel
from flock_sim.nodes.drain import Flier, keep_flying
from flock_sim.nodes.patience import Patience
from flock_sim.stop import Stop
from flock_sim.times import Times


class Stopwatch:
    """Times all birds of one process."""

    def __init__(self) -> None:
        """Stand at zero: the time begins with the first stage."""
        self._begun: float | None = None
        self._ended = 0.0
        self._kernel = 0.0
        self._busy = 0.0

    @property
    def times(self) -> Times:
        """Where the time went, from the first stage to the last so far."""
        if self._begun is None:
            return Times(0.0, 0.0, 0.0)
        waiting = self._ended - self._begun - self._busy
        return Times(self._kernel, self._busy - self._kernel, max(0.0, waiting))

    def around(self, kernel: StageKernel) -> StageKernel:
        """Return `kernel` with the watch around it."""

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
        patience: Patience,
        look_around: Callable[[], bool],
    ) -> None:
        """Do as `drain.keep_flying`, with the watch around all that they find to do."""
        watched = [self.watched(bird) for bird in birds]
        keep_flying(watched, executor, stop, patience, lambda: self.fruitful(look_around))

    def watched(self, bird: Flier) -> Flier:
        """Return `bird` with the watch around all that it finds to do."""
        return _Watched(bird, self.fruitful)

    def fruitful(self, work: Callable[[], bool]) -> bool:
        """Do `work`, and count its time where it came upon something to do."""
        begun = perf_counter()
        moved = work()
        if moved and self._begun is not None:
            self._busy += perf_counter() - max(begun, self._begun)
        return moved


class _Watched:
    """A bird whose time is taken."""

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
