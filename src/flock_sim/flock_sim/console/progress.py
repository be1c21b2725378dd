# SPDX-License-Identifier: Apache-2.0
"""Progress bars of long computations, on a terminal only."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from flock_sim.configuration.flock_configuration import FlockConfiguration

TIME_LEFT = ""
"""Placeholder for the time left, among the columns of a bar."""


@contextmanager
def progress_bar(what: str, configuration: FlockConfiguration) -> Iterator[Callable[[int], None]]:
    """Yield a function of the step reached; it shows step, simulated time, rate and time left."""
    columns = (
        "step {task.completed:.0f}/{task.total:.0f}  t = {task.fields[time]:.6g}",
        "{task.fields[rate]:.0f} steps/s",
        TIME_LEFT,
    )
    with _bar(what, configuration.steps, columns) as update:
        begun: list[tuple[float, int]] = []

        def show(step: int) -> None:
            if step > 0 and not begun:
                begun.append((time.monotonic(), step))
            rate = 0.0
            if begun and step > begun[0][1]:
                rate = (step - begun[0][1]) / (time.monotonic() - begun[0][0])
            reached = max(step, 0)
            update(completed=reached, time=configuration.time(reached), rate=rate)

        yield show


@contextmanager
def counter(what: str, unit: str, total: float) -> Iterator[Callable[[float], None]]:
    """Yield a function of the further amount of `total` done; it shows rate and time left."""
    columns = (f"{{task.fields[rate]:,.0f}} {unit}/s", TIME_LEFT)
    with _bar(what, total, columns) as update:
        begun, done = time.monotonic(), 0.0

        def show(more: float) -> None:
            nonlocal done
            done += more
            update(completed=done, rate=done / max(1e-9, time.monotonic() - begun))

        yield show


@contextmanager
def stages() -> Iterator[Callable[[str, float], None]]:
    """Yield a function of what is being done and of the fraction of it that is done."""
    with _bar("", 1.0, (TIME_LEFT,)) as update:

        def show(what: str, done: float) -> None:
            update(description=what, completed=done)

        yield show


@contextmanager
def playback_bar(length: float) -> Iterator[Callable[[float, float, bool], None]]:
    """Yield a function of the recorded time reached, in s of `length`, the rate and the pause.

    The bar does not show the time left, which would include pauses.
    """
    place = f"{{task.fields[time]:.2f}} of {length:.2f} s  rate {{task.fields[rate]:.3g}}"
    with _bar("playing", length, (place,)) as update:

        def show(reached: float, rate: float, paused: bool) -> None:
            what = "paused " if paused else "playing"
            update(description=what, completed=reached, time=reached, rate=rate)

        yield show


@contextmanager
def _bar(what: str, total: float, columns: tuple[str, ...]) -> Iterator[Callable[..., None]]:
    """Yield a function that updates the fields of a bar with `columns`; on a terminal only."""
    if not sys.stderr.isatty():
        yield lambda **fields: None
        return
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        Progress,
        TaskProgressColumn,
        TextColumn,
        TimeRemainingColumn,
    )

    ends = (TextColumn("{task.description}"), BarColumn(bar_width=None), TaskProgressColumn())
    with Progress(
        *ends,
        *(
            TextColumn(column) if column else TimeRemainingColumn(compact=True)
            for column in columns
        ),
        console=Console(stderr=True),
        refresh_per_second=5,
    ) as bar:
        task = bar.add_task(what, total=total, time=0.0, rate=0.0)
        yield lambda **fields: bar.update(task, **fields)
