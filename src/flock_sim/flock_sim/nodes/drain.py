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

SWEEPS = 16
"""Sweeps over a group of birds before the next one has its turn, and looks for leave after all."""

GROUP = 32
"""So many birds of a process take their turns together, before others have theirs."""

RARELY = 16
"""One in so many turns also looks for what comes rarely, bird by bird. Where many processes share
few cores, most turns find nothing, and each takes its core from a bird that could go on."""

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
    groups = _groups(birds)
    turns = fruitless = reports = 0
    while True:
        moved = False
        turns += 1
        rarely = turns % RARELY == 0 or fruitless >= FRUITLESS_SWEEPS
        for group in groups:
            moved |= _go_on(group)
        if stop:
            return
        if moved or rarely:
            moved |= look_around()
        if rarely:
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
        patience.wait(lambda: next((b.waiting_for for b in birds if not b.finished), "nothing"))


def _go_on(group: Sequence[Flier]) -> bool:
    """Let the birds of a group go on, as far as they can; return whether any could.

    After one that could, its neighbours are looked at again: it was they who may have waited.
    """
    moved, first, end = False, 0, len(group)
    for _ in range(SWEEPS):
        able = [place for place in range(first, end) if group[place].drain()]
        if not able:
            break
        moved = True
        first, end = max(0, able[0] - 1), min(len(group), able[-1] + 2)
    return moved


def _groups(birds: Sequence[Flier]) -> list[Sequence[Flier]]:
    """Return the birds in the order in which they get their turns, for as long as each can go on.

    A bird may be one stage ahead of its neighbours, so within a group those in the middle come far
    before they have to wait for others. That is what few have to do at a time, and the processor's
    caches hold what they need. Groups are shifted by half in between: edges become middles.
    """
    if len(birds) <= GROUP:
        return [birds]
    return [
        birds[max(0, first) : first + GROUP]
        for shift in (0, GROUP // 2)
        for first in range(-shift, len(birds), GROUP)
    ]
