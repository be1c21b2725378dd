# SPDX-License-Identifier: Apache-2.0
"""The main loop of a flight: birds take their messages themselves as long as any arrive.

With an executor alone, a message costs several times the time that its reading takes.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from typing import Protocol

from rclpy.executors import Executor

from flock_sim.console.signals import Stop
from flock_sim.ros.watchdog import Watchdog

SWEEPS = 16
"""Most sweeps over a group of birds before the next group has its turn; grants come after all."""

GROUP = 32
"""Number of birds polled as one batch."""

RARELY = 16
"""Turns per look at rare messages, bird by bird. If many processes share few cores, most such looks
find nothing, and take the core from a bird that could continue."""

YIELDS = 20
"""First turns without a message: after each, the processor is yielded to a ready process."""

NAP = 20e-6
"""Sleep after each further turn without a message, in s. A yield on Linux only helps processes of
the same session, so without the sleep birds in separate terminals would block each other."""

SERVE_EVERY = 0.05
"""Time between two calls of the executor in flight, in s. They serve parameters, without a wait."""

FRUITLESS_SWEEPS = 60
"""Turns without a message before the executor waits."""

WAIT = 0.001
"""Longest single wait of the executor, in s: the longest delay of a stage message."""

REPORT_EVERY = 1.0
"""Time between two reports of a waiting bird, in s. A silent bird is then the blocker."""


RESTLESS = 0.1
REST = 0.02
"""After RESTLESS s without a message the single wait is REST s, which frees the processor."""


class Flier(Protocol):
    """The interface of a bird that `keep_flying` uses."""

    def drain(self) -> bool:
        """Take frequent messages; return whether any came."""

    def drain_rare(self) -> bool:
        """Take rare messages; return whether any came."""

    def report(self) -> None:
        """Report to the clock that this bird is present and waits."""

    @property
    def finished(self) -> bool:
        """Whether there is nothing left to do."""

    @property
    def waiting_for(self) -> str:
        """The name of the bird and what it waits for, as text."""


def keep_flying(
    birds: Sequence[Flier],
    executor: Executor,
    stop: Stop,
    watchdog: Watchdog,
    look_around: Callable[[], bool] = lambda: False,
) -> None:
    """Fly `birds` to the end: drain their topics while messages arrive, else let `executor` wait.

    Calls `look_around` from time to time, which returns whether a message came. Returns early on
    `stop`. Raises RunFailed if `watchdog` runs out.
    """
    groups = _groups(birds)
    turns = fruitless = reports = 0
    serve_at = 0.0
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
            if time.monotonic() > serve_at:
                executor.spin_once(timeout_sec=0.0)
                serve_at = time.monotonic() + SERVE_EVERY
            for bird in birds:
                if bird.drain_rare():
                    moved = True
        if moved:
            fruitless = 0
            continue
        if all(bird.finished for bird in birds):
            return
        if fruitless == 0:
            watchdog.reset()
            reports = 0
        fruitless += 1
        if fruitless < FRUITLESS_SWEEPS:
            if fruitless <= YIELDS:
                os.sched_yield()
            else:
                time.sleep(NAP)
            continue
        executor.spin_once(timeout_sec=WAIT if watchdog.silence < RESTLESS else REST)
        if watchdog.silence > REPORT_EVERY * (reports + 1):
            reports += 1
            for bird in birds:
                bird.report()
        watchdog.wait(lambda: next((b.waiting_for for b in birds if not b.finished), "nothing"))


def _go_on(group: Sequence[Flier]) -> bool:
    """Let the birds of a group continue as far as they can; return whether any could.

    The next sweep polls only the birds that could continue and their neighbours, which may have
    waited for them.
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
    """Return the groups of birds in the order of their turns.

    A bird may be one stage ahead of its neighbours. So the birds in the middle of a group can fly
    many stages before they must wait for other groups. During these stages the processor's caches
    hold the data of the group. Every second set of groups is shifted by half a group, so that edges
    become middles.
    """
    if len(birds) <= GROUP:
        return [birds]
    return [
        birds[max(0, first) : first + GROUP]
        for shift in (0, GROUP // 2)
        for first in range(-shift, len(birds), GROUP)
    ]
