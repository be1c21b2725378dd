# SPDX-License-Identifier: Apache-2.0
"""The hot path of a flight: birds take their messages themselves while there are any.

Served by an executor alone, a message costs several times what it takes to read it.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from typing import Protocol

from rclpy.executors import Executor

from flock_sim.nodes.patience import Patience
from flock_sim.nodes.process import Stop

SWEEPS_PER_GRANT = 16
"""Sweeps over the birds between two looks for leave while there is work."""

FRUITLESS_SWEEPS = 1000
"""Sweeps without a message, each giving the processor away, before the executor has to wait."""

WAIT = 0.001
"""How long the executor waits at a time, in s: the longest that a stage message may lie."""

REPORT_EVERY = 1.0
"""How often, in s, a bird that waits says that it does: who says nothing is waited for."""


RESTLESS = 0.1
REST = 0.02
"""After RESTLESS s of silence it waits for REST s at a time, and leaves the processor to others."""


class Flier(Protocol):
    """What `keep_flying` asks of a bird."""

    def drain(self) -> bool:
        """Take what comes often; return whether anything came."""

    def drain_rare(self) -> bool:
        """Take what comes rarely; return whether anything came."""

    def report(self) -> None:
        """Tell the clock that it is there, and waits."""

    @property
    def finished(self) -> bool:
        """Whether there is nothing left to do."""

    @property
    def waiting_for(self) -> str:
        """Who waits for what, in words."""


def keep_flying(
    birds: Sequence[Flier],
    executor: Executor,
    stop: Stop,
    patience: Patience,
    look_around: Callable[[], bool] = lambda: False,
) -> None:
    """Fly `birds` to the end: drain their topics while there is work, else let the executor wait.

    Calls `look_around` now and then; it returns whether anything came. Returns early on `stop`.
    Raises RunFailed when `patience` runs out.
    """
    sweeps = fruitless = reports = 0
    while True:
        moved = False
        for bird in birds:
            if bird.drain():
                moved = True
        sweeps += 1
        if moved:
            fruitless = 0
            if sweeps % SWEEPS_PER_GRANT:
                continue
        if stop:
            return
        moved |= look_around()
        for bird in birds:
            if bird.drain_rare():
                moved = True
        if moved:
            fruitless = 0
            continue
        if all(bird.finished for bird in birds):
            return
        if fruitless == 0:
            patience.renew()
            reports = 0
        fruitless += 1
        if fruitless < FRUITLESS_SWEEPS:
            os.sched_yield()
            continue
        executor.spin_once(timeout_sec=WAIT if patience.silence < RESTLESS else REST)
        if patience.silence > REPORT_EVERY * (reports + 1):
            reports += 1
            for bird in birds:
                bird.report()
        patience.wait(lambda: next(bird.waiting_for for bird in birds if not bird.finished))
