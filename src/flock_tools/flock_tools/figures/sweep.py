# SPDX-License-Identifier: Apache-2.0
"""The picture of a sweep: curves along one axis, maps over two, one map per value of a third."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import matplotlib as mpl
import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, QuadMesh
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure

from flock_sim.analysis.metrics import STABLE_BELOW
from flock_sim.analysis.verdict import HOLDS, WORDS
from flock_sim.physics.arrays import BoolArray, FloatArray
from flock_tools.experiments.sweep.axes import Axis
from flock_tools.experiments.sweep.dataset import counted
from flock_tools.experiments.sweep.specification import Sweep
from flock_tools.figures.style import ALARM, BLUE, COLUMN, FAINT, INK, PAGE, PRINT_STYLE, SMALL

MOST_PANELS = 6
TICKS = (6, 5, 7, 4)
"""Numbers of tick labels of an axis. The first that gives even steps is used."""

LEAST_SPREAD = 1e-16
"""Least spread that is drawn on a logarithmic axis, in place of 0, in U_min."""

SPREAD = "spread of speeds $\\sigma_U$ ($U_\\mathrm{min}$)"
SPACING = "mean spacing (b)"
UNITS = {"U_min": "$U_\\mathrm{min}$", "b/U_min": "b/$U_\\mathrm{min}$"}


def draw_sweep(found: xr.Dataset, sweep: Sweep) -> Figure:
    """Return the picture of the results of a sweep.

    Axes beyond the third are shown at their first value, which the title gives.
    """
    found, axes = _ascending(found, sweep.axes)
    rest = {axis.dimension: 0 for axis in axes[3:]}
    title = _title(found, axes[3:])
    with mpl.rc_context(PRINT_STYLE):
        if len(axes) == 1:
            figure = _curves(found, axes[0])
        elif len(axes) == 2:
            figure = _maps(found, axes[0], axes[1])
        else:
            figure = _panels(found.isel(rest), axes[0], axes[1], axes[2])
        figure.suptitle(title, x=0.01, ha="left", fontsize=8.0)
    return figure


def _ascending(found: xr.Dataset, axes: Sequence[Axis]) -> tuple[xr.Dataset, list[Axis]]:
    """Return results and axes with the numbers of the drawn axes in ascending order."""
    ordered = list(axes)
    for k, axis in enumerate(axes[:3]):
        if not isinstance(axis.values[0], str):
            order = np.argsort(np.array(axis.values, dtype=float))
            found = found.isel({axis.dimension: order})
            ordered[k] = replace(axis, values=tuple(axis.values[at] for at in order))
    return found, ordered


def _title(found: xr.Dataset, first_only: Sequence[Axis]) -> str:
    counts = counted(found)
    title = f"{found.verdict.size} flocks: "
    title += ", ".join(f"{count} {word}" for word, count in counts.items() if count)
    if diverged := int(found.diverged.sum()):
        title += f", {diverged} diverged"
    if first_only:
        title += "; shown at " + ", ".join(f"{a.name} = {_tick(a.values[0])}" for a in first_only)
    return title


def _curves(found: xr.Dataset, axis: Axis) -> Figure:
    figure = Figure(figsize=(PAGE, 2.7), layout="constrained")
    left, right = figure.subplots(1, 2)
    across = _across(left, right, axis)
    words = isinstance(axis.values[0], str)
    kind = {
        "linestyle": "" if words else "-",
        "color": BLUE,
        "marker": "o" if len(axis.values) <= 60 else "",
        "markersize": 2.6,
    }
    left.plot(across, np.maximum(found.speed_std, LEAST_SPREAD), **kind)
    left.set(ylabel=SPREAD, yscale="log")
    left.update_datalim([(across[0], STABLE_BELOW / 3.0)])  # room for the label
    left.autoscale_view()
    left.axhline(STABLE_BELOW, color=ALARM, linewidth=0.8, linestyle="--")
    left.annotate(
        "stable below (the paper's criterion)",
        (1.0, STABLE_BELOW),
        xycoords=("axes fraction", "data"),
        xytext=(0, -2),
        textcoords="offset points",
        ha="right",
        va="top",
        color=ALARM,
        fontsize=SMALL,
    )
    if "mean_spacing" in found:
        right.plot(across, found.mean_spacing, **kind)
        right.set(ylabel=SPACING)
        _log_if_wide(right, found.mean_spacing.values)
    else:
        right.plot(across, found.mean_speed, **kind)
        right.set(ylabel="mean speed ($U_\\mathrm{min}$)")
    for one in (left, right):
        one.grid(visible=True)
        one.set_xlabel(_label(axis))
    return figure


def _across(left: Axes, right: Axes, axis: Axis) -> Sequence[float]:
    """Return the places of an axis's values. Text values are evenly spaced."""
    if not isinstance(axis.values[0], str) and np.isfinite(axis.values).all():
        return [float(value) for value in axis.values]
    for axes in (left, right):
        _ticks(axes, "x", axis)
    return list(range(len(axis.values)))


def _maps(found: xr.Dataset, down: Axis, across: Axis) -> Figure:
    figure = Figure(figsize=(PAGE, 3.1), layout="constrained")
    left, right = figure.subplots(1, 2)
    holds = _holds(found)
    image = _map(left, _spread(found), holds, _spread_norm(found))
    figure.colorbar(image, ax=left, label=SPREAD).ax.axhline(STABLE_BELOW, color="white")
    name, label = ("mean_spacing", SPACING) if "mean_spacing" in found else ("mean_speed", "U")
    values = np.where(found.diverged, np.nan, found[name])
    image = _map(right, values, holds, _norm(values))
    figure.colorbar(image, ax=right, label=label)
    for axes in (left, right):
        _ticks(axes, "y", down)
        _ticks(axes, "x", across)
        axes.set(xlabel=_label(across), ylabel=_label(down))
    return figure


def _panels(found: xr.Dataset, down: Axis, across: Axis, panel: Axis) -> Figure:
    """Draw maps of sigma_U for evenly chosen values of a third axis, with both ends."""
    count = min(MOST_PANELS, len(panel.values))
    shown = sorted({round(k) for k in np.linspace(0, len(panel.values) - 1, count)})
    columns = min(3, len(shown))
    rows = -(-len(shown) // columns)
    width = PAGE if columns > 1 else COLUMN * 1.4
    figure = Figure(figsize=(width, 0.4 + 2.4 * rows), layout="constrained")
    grid = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    norm = _spread_norm(found)
    for axes, k in zip(grid.flat, shown):
        part = found.isel({panel.dimension: k})
        image = _map(axes, _spread(part), _holds(part), norm)
        axes.set_title(f"{panel.name} = {_tick(panel.values[k])}")
        _ticks(axes, "y", down)
        _ticks(axes, "x", across)
        axes.label_outer()
    for axes in grid.flat[len(shown) :]:
        axes.set_visible(False)
    for axes in grid.flat[max(0, len(shown) - columns) : len(shown)]:  # the lowest panels
        axes.tick_params(labelbottom=True)
        axes.set_xlabel(_label(across))
    for axes in grid[:, 0]:
        axes.set_ylabel(_label(down))
    figure.colorbar(image, ax=grid, label=SPREAD).ax.axhline(STABLE_BELOW, color="white")
    return figure


def _map(axes: Axes, values: FloatArray, holds: BoolArray, norm: Normalize) -> QuadMesh:
    """Draw cells, but none for diverged flocks, and the border of flocks that hold."""
    rows, columns = values.shape
    image = axes.pcolormesh(
        np.arange(columns + 1) - 0.5,
        np.arange(rows + 1) - 0.5,
        np.ma.masked_invalid(values),
        norm=norm,
        cmap="viridis",
        rasterized=True,
    )
    axes.set_facecolor("#e3e6e9")
    axes.patch.set(hatch="////", edgecolor=FAINT)
    upright = [((c + 0.5, r - 0.5), (c + 0.5, r + 0.5)) for r, c in _changes(holds, 1)]
    level = [((c - 0.5, r + 0.5), (c + 0.5, r + 0.5)) for r, c in _changes(holds, 0)]
    axes.add_collection(LineCollection([*upright, *level], colors="white", linewidths=1.4))
    axes.add_collection(LineCollection([*upright, *level], colors=INK, linewidths=0.6))
    return image


def _holds(found: xr.Dataset) -> BoolArray:
    return np.asarray(found.verdict.values == WORDS.index(HOLDS))


def _changes(holds: BoolArray, axis: int) -> list[tuple[int, int]]:
    return [(int(r), int(c)) for r, c in np.argwhere(np.diff(holds.astype(int), axis=axis))]


def _spread(found: xr.Dataset) -> FloatArray:
    spread = np.where(found.diverged, np.nan, found.speed_std)
    return np.maximum(spread, LEAST_SPREAD)


def _spread_norm(found: xr.Dataset) -> LogNorm:
    """Return a scale that contains the threshold of stability."""
    spread = _spread(found)
    spread = spread[np.isfinite(spread)]
    low, high = (spread.min(), spread.max()) if spread.size else (STABLE_BELOW, STABLE_BELOW)
    return LogNorm(min(low, STABLE_BELOW / 10.0), max(high, STABLE_BELOW * 10.0))


def _norm(values: FloatArray) -> Normalize:
    found = values[np.isfinite(values)]
    if not found.size:
        return Normalize(0.0, 1.0)
    return (
        LogNorm(found.min(), found.max()) if _wide(found) else Normalize(found.min(), found.max())
    )


def _wide(values: FloatArray) -> bool:
    return bool(values.min() > 0.0 and values.max() > 20.0 * values.min())


def _log_if_wide(axes: Axes, values: FloatArray) -> None:
    finite = values[np.isfinite(values)]
    if finite.size and _wide(finite):
        axes.set_yscale("log")


def _ticks(axes: Axes, which: str, axis: Axis) -> None:
    """Label evenly chosen values of an axis."""
    last = len(axis.values) - 1
    even = (count for count in TICKS if last % (count - 1) == 0)
    count = last + 1 if last < max(TICKS) else next(even, TICKS[0])
    places = sorted({round(k) for k in np.linspace(0, last, count)})
    labels = [_tick(axis.values[k]) for k in places]
    axes.set(**{f"{which}ticks": places, f"{which}ticklabels": labels})


def _tick(value: float | str) -> str:
    return value if isinstance(value, str) else f"{value:.4g}"


def _label(axis: Axis) -> str:
    units = "" if axis.units == "1" else f" ({UNITS.get(axis.units, axis.units)})"
    return f"{axis.long_name}{units}"
