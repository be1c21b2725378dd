# SPDX-License-Identifier: Apache-2.0
"""The hot path of a flight: birds take their messages themselves while there are any.

Served by an executor alone, a message costs several times what it takes to read it.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from typing import Protocol

from rclpy.executors import Executor

from flock_sim.errors import RunFailed
from flock_sim.nodes.process import Stop

SWEEPS_PER_GRANT = 16
"""Sweeps over the birds between two looks for leave while there is work."""

PATIENCE = 1000
"""Fruitless sweeps, each giving the processor away, before the executor is asked to wait."""

WAIT = 0.001
"""How long the executor waits at a time, in s: the longest that a stage message may lie."""

SAY_AFTER = 5.0
"""Silence, in s, after which a bird says what it waits for."""


class Flier(Protocol):
    """What `fly` asks of a bird."""

    def drain(self) -> bool:
        """Take what comes often; return whether anything came."""

    def drain_rare(self) -> bool:
        """Take what comes rarely; return whether anything came."""

    @property
    def finished(self) -> bool:
        """Whether there is nothing left to do."""

    @property
    def waiting_for(self) -> str:
        """Who waits for what, in words."""


def fly(
    birds: Sequence[Flier],
    executor: Executor,
    stop: Stop,
    timeout: float,
    say: Callable[[str], None],
) -> None:
    """Fly `birds` to the end: drain their topics while there is work, else let the executor wait.

    Returns early on `stop`. Tells `say` what is waited for when nothing comes,
    and raises RunFailed where nothing came for `timeout` s.
    """
    sweeps = fruitless = 0
    heard = time.monotonic()
    said = False
    while True:
        moved = False
        for bird in birds:
            if bird.drain():
                moved = True
        sweeps += 1
        if moved and sweeps % SWEEPS_PER_GRANT:
            continue
        if stop:
            return
        for bird in birds:
            if bird.drain_rare():
                moved = True
        if moved:
            fruitless = 0
            continue
        if all(bird.finished for bird in birds):
            return
        fruitless += 1
        if fruitless == 1:
            heard, said = time.monotonic(), False
        if fruitless < PATIENCE:
            os.sched_yield()
            continue
        executor.spin_once(timeout_sec=WAIT)
        silence = time.monotonic() - heard
        if silence > timeout or (silence > SAY_AFTER and not said):
            said = True
            waiting = next(bird.waiting_for for bird in birds if not bird.finished)
            waits = f"{waiting}, for {silence:.0f} s"
            if silence > timeout:
                raise RunFailed(f"{waits}: start what is missing, or raise `timeout`")
            say(waits)
