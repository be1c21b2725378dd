# SPDX-License-Identifier: Apache-2.0
"""What is written in the picture of a sweep: titles, and names of axes and values."""

from __future__ import annotations

from collections.abc import Sequence

import xarray as xr

from flock_tools.experiments.sweep.axes import Axis
from flock_tools.experiments.sweep.dataset import counted
from flock_tools.experiments.sweep.specification import Sweep
from flock_tools.figures.style import COUPLING_NAMES, UNITS, links_name


def flock_title(sweep: Sweep) -> str:
    """Return what all flocks have in common: birds, and coupling and links if no axis has it."""
    flock = sweep.flock
    title = f"{flock.birds} bird{'s' * (flock.birds > 1)}"
    if flock.birds > 1 and all(axis.dimension != "coupling" for axis in sweep.axes):
        title += f", {COUPLING_NAMES[flock.coupling]} coupling"
    if flock.links:
        title += f"\n{links_name(flock.links, 0)}"
    elif flock.birds > 1:
        title += ", exact links"
    varied = [axis.long_name for axis in sweep.axes if axis.dimension.startswith("link_")]
    return title + "".join(f"; {name} varies" for name in varied)


def results_title(found: xr.Dataset, first_only: Sequence[Axis]) -> str:
    """Return how many flocks have each verdict, and the value of each axis in `first_only`."""
    counts = counted(found)
    title = f"{found.verdict.size} flocks: "
    title += ", ".join(f"{count} {word}" for word, count in counts.items() if count)
    if diverged := int(found.diverged.sum()):
        title += f", {diverged} diverged"
    if first_only:
        title += "; shown at " + ", ".join(at(axis, axis.values[0]) for axis in first_only)
    return title


def at(axis: Axis, value: float | str) -> str:
    """Return an axis at a value: its name, the value and its unit."""
    unit = "" if axis.units == "1" or isinstance(value, str) else f" {unit_name(axis.units)}"
    return f"{_name(axis)} = {tick(value)}{unit}"


def tick(value: float | str) -> str:
    """Return a value of an axis as it is written beside it."""
    return COUPLING_NAMES.get(value, value) if isinstance(value, str) else f"{value:.4g}"


def label(axis: Axis) -> str:
    """Return the name of an axis, with its unit."""
    units = "" if axis.units == "1" else f" ({unit_name(axis.units)})"
    return f"{_name(axis)}{units}"


def _name(axis: Axis) -> str:
    return axis.name if axis.name == "coupling" else axis.long_name


def unit_name(unit: str) -> str:
    """Return a unit as it is written in a picture."""
    return UNITS.get(unit, unit)
