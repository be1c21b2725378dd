# SPDX-License-Identifier: Apache-2.0
"""Recorded flights: as datasets, and as pictures."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from flock_sim.errors import FlockError

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure

    from flock_tools.runs.comparison import Comparison


def load(
    path: str | Path, start: float | None = None, end: float | None = None, stride: int = 1
) -> xr.Dataset:
    """Return a recorded flight from time `start` to `end` in b/U_min, every `stride`-th record.

    As `flock_tools.load`, without the dimension `member` if the flight has one member only.
    """
    from flock_tools.runs.dataset import load as recorded

    return without_single_member(recorded(path, start, end, stride))


def without_single_member(found: xr.Dataset) -> xr.Dataset:
    """Return a dataset without the dimension `member` if it has one member."""
    if found.sizes.get("member") == 1:
        return found.squeeze("member", drop=True)
    return found


def compare(first: str | Path, second: str | Path, tolerance: float | None = None) -> Comparison:
    """Compare two recorded flights bit for bit, or to within `tolerance`, as `compare` does."""
    from flock_sim.recording.run import Run
    from flock_tools.runs.comparison import compare as compare_runs

    with Run(first) as one, Run(second) as other:
        return compare_runs(one, other, tolerance)


def picture(path: str | Path, at: float | None = None, member: int = 1) -> Figure:
    """Draw the formation of a recorded flight and how it formed, as `picture` does.

    `at` is a recorded time in b/U_min; None is the end.
    """
    from flock_sim.recording.run import Run
    from flock_tools.figures.run_history import draw_run

    with Run(path) as run:
        members = run.configuration.members
        if not 1 <= member <= members:
            raise FlockError(f"member = {member}: must be from 1 to {members}")
        return draw_run(run, at, member)
