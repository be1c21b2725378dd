# SPDX-License-Identifier: Apache-2.0
"""The picture of a sweep: curves along one axis, maps over two, one map per value of a third."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from textwrap import fill
from typing import Any

import matplotlib as mpl
import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, QuadMesh
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from flock_sim.analysis.metrics import STABLE_BELOW
from flock_sim.analysis.verdict import APART, HOLDS, SETTLING, STALLED, WORDS
from flock_sim.physics.arrays import BoolArray, FloatArray
from flock_tools.experiments.sweep.axes import Axis
from flock_tools.experiments.sweep.specification import Sweep
from flock_tools.figures.style import (
    ALARM,
    BLUE,
    COLUMN,
    FAINT,
    INK,
    PAGE,
    PRINT_STYLE,
)
from flock_tools.figures.sweep_labels import at, flock_title, label, results_title, tick, unit_name

MOST_PANELS = 6
TICKS = (6, 5, 7, 4)
"""Numbers of tick labels of an axis. The first that gives even steps is used."""

MOST_MARKED = 60
"""Largest number of flocks along an axis that are marked by their verdicts."""

TITLE = 34
"""Number of characters of a line above a map."""

LEAST_SPREAD = 1e-16
"""Least spread that is drawn on a logarithmic axis, in place of 0, in U_min."""

SPREAD = "spread of speeds $\\sigma_U$ ($U_\\mathrm{min}$)"

MEANS = {
    "mean_spacing": ("mean spacing", "b", 0.1),
    "mean_speed": ("mean speed", "U_min", 0.01),
}
"""Panels beside that of the spread: name, unit, and the smallest range that an axis shows."""

CRITERION = f"$\\sigma_U$ = {STABLE_BELOW:g}: the paper's criterion"

MARKS = {HOLDS: "o", SETTLING: "D", APART: "s", STALLED: "^"}
"""Marks of verdicts. That of flocks that hold is filled."""

NOTHING = "#e3e6e9"
"""Colour below the hatching of flocks that diverged."""


def draw_sweep(found: xr.Dataset, sweep: Sweep) -> Figure:
    """Return the picture of the results of a sweep.

    Axes beyond the third are shown at their first value, which the title gives.
    """
    found, axes = _ascending(found, sweep.axes)
    rest = {axis.dimension: 0 for axis in axes[3:]}
    title = f"{flock_title(sweep)}\n{results_title(found, axes[3:])}"
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


def _shown(found: xr.Dataset) -> list[str]:
    """Return the means that have a panel. A bird alone has no spacing."""
    return [name for name in MEANS if name in found]


def _curves(found: xr.Dataset, axis: Axis) -> Figure:
    names = _shown(found)
    figure = Figure(figsize=(PAGE, 3.0), layout="constrained")
    panels = figure.subplots(1, 1 + len(names))
    across = _across(panels, axis)
    spread = np.maximum(found.speed_std.to_numpy(), LEAST_SPREAD)
    line = "" if isinstance(axis.values[0], str) else "-"
    handles = _curve(panels[0], across, spread, found, line)
    low, high = _spread_range(found)
    panels[0].set(ylabel=SPREAD, yscale="log", ylim=(0.5 * low, 2.0 * high))
    criterion = panels[0].axhline(
        STABLE_BELOW, color=ALARM, linewidth=0.8, linestyle="--", label=f"{CRITERION}, stable below"
    )
    for axes, name in zip(panels[1:], names):
        told, unit, least = MEANS[name]
        values = found[name].to_numpy()
        _curve(axes, across, values, found, line)
        scale = _scale(axes, values, least)
        axes.set(ylabel=f"{told} ({unit_name(unit)}){scale}")
    for axes in panels:
        axes.grid(visible=True)
        axes.set_xlabel(label(axis))
    handles.append(criterion)
    figure.legend(handles=handles, loc="outside lower left", ncols=len(handles))
    return figure


def _curve(
    axes: Axes, across: Sequence[float], values: FloatArray, found: xr.Dataset, line: str
) -> list[Line2D]:
    """Draw values against an axis, marked by verdicts; return the marks for a legend."""
    place = np.array(across)
    axes.plot(place, values, color=BLUE, linestyle=line, linewidth=0.8)
    if len(place) > MOST_MARKED:
        return []
    verdicts = found.verdict.to_numpy()
    marks = []
    for k, word in enumerate(WORDS):
        if not (verdicts == k).any():
            continue
        marks += axes.plot(
            place[verdicts == k],
            values[verdicts == k],
            MARKS[word],
            color=BLUE,
            markersize=3.0,
            markerfacecolor=BLUE if word == HOLDS else "white",
            label=word,
        )
    return marks


def _scale(axes: Axes, values: FloatArray, least: float) -> str:
    """Scale an axis for `values`, with a range of `least` or more; return what its label says."""
    finite = values[np.isfinite(values)]
    axes.ticklabel_format(axis="y", useOffset=False)
    if not finite.size:
        return ""
    if _wide(finite):
        axes.set_yscale("log")
        return ", logarithmic"
    low, high = _range(finite, least)
    room = 0.05 * (high - low)
    axes.set_ylim(low - room, high + room)
    return ""


def _range(values: FloatArray, least: float) -> tuple[float, float]:
    """Return the ends of the range of `values`, extended on both sides to `least`."""
    low, high = float(values.min()), float(values.max())
    more = 0.5 * max(0.0, least - (high - low))
    return low - more, high + more


def _across(panels: Iterable[Axes], axis: Axis) -> Sequence[float]:
    """Return the places of an axis's values. Text values are evenly spaced."""
    if not isinstance(axis.values[0], str) and np.isfinite(axis.values).all():
        return [float(value) for value in axis.values]
    for axes in panels:
        _ticks(axes, "x", axis)
    return list(range(len(axis.values)))


def _maps(found: xr.Dataset, down: Axis, across: Axis) -> Figure:
    names = _shown(found)
    figure = Figure(figsize=(PAGE, 3.5), layout="constrained")
    panels = figure.subplots(1, 1 + len(names))
    holds = _holds(found)
    image = _map(panels[0], _spread(found), holds, LogNorm(*_spread_range(found)))
    _colour_bar(figure, panels[0], image, SPREAD, spread=True)
    for axes, name in zip(panels[1:], names):
        told, unit, least = MEANS[name]
        values = np.where(found.diverged, np.nan, found[name])
        norm = _norm(values, least)
        image = _map(axes, values, holds, norm)
        scale = ", logarithmic" if isinstance(norm, LogNorm) else ""
        _colour_bar(figure, axes, image, f"{told} ({unit_name(unit)}){scale}")
    for axes in panels:
        _ticks(axes, "y", down)
        _ticks(axes, "x", across)
        axes.set(xlabel=label(across))
    for axes in panels[1:]:
        axes.tick_params(labelleft=not isinstance(down.values[0], str))  # words are long
    panels[0].set_ylabel(label(down))
    _explain(figure, found)
    return figure


def _colour_bar(
    figure: Figure,
    axes: Axes | NDArray[Any],
    image: QuadMesh,
    told: str,
    spread: bool = False,
) -> None:
    """Draw the scale of a map above it; that of the spread has a line at the criterion."""
    wide = 25 if isinstance(axes, Axes) else 25 * axes.shape[1]
    bar = figure.colorbar(image, ax=axes, label=told, location="top", aspect=wide, pad=0.02)
    if spread:
        bar.ax.axvline(STABLE_BELOW, color="white", linewidth=2.0)
        bar.ax.axvline(STABLE_BELOW, color=ALARM, linewidth=1.0)
    elif not isinstance(image.norm, LogNorm):
        bar.locator = MaxNLocator(4)
        bar.update_ticks()
        bar.ax.ticklabel_format(axis="x", useOffset=False)


def _explain(figure: Figure, found: xr.Dataset) -> None:
    """Explain the lines of maps and scales."""
    handles: list[Line2D | Patch] = []
    if len(np.unique(_holds(found))) > 1:
        border = "border of the flocks that hold (verdict)"
        handles.append(Line2D([], [], color=INK, linewidth=0.8, label=border))
    criterion = f"in the scale: {CRITERION}"
    handles.append(Line2D([], [], color=ALARM, linewidth=1.0, label=criterion))
    if found.diverged.any():
        handles.append(Patch(facecolor=NOTHING, edgecolor=FAINT, hatch="////", label="diverged"))
    figure.legend(handles=handles, loc="outside lower left", ncols=len(handles))


def _panels(found: xr.Dataset, down: Axis, across: Axis, panel: Axis) -> Figure:
    """Draw maps of sigma_U for evenly chosen values of a third axis, with both ends."""
    count = min(MOST_PANELS, len(panel.values))
    shown = sorted({round(k) for k in np.linspace(0, len(panel.values) - 1, count)})
    columns = min(3, len(shown))
    rows = -(-len(shown) // columns)
    width = PAGE if columns > 1 else COLUMN * 1.4
    figure = Figure(figsize=(width, 1.1 + 2.4 * rows), layout="constrained")
    grid = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    norm = LogNorm(*_spread_range(found))
    for axes, k in zip(grid.flat, shown):
        part = found.isel({panel.dimension: k})
        image = _map(axes, _spread(part), _holds(part), norm)
        axes.set_title(fill(at(panel, panel.values[k]), TITLE))
        _ticks(axes, "y", down)
        _ticks(axes, "x", across)
        axes.label_outer()
    for axes in grid.flat[len(shown) :]:
        axes.set_visible(False)
    for axes in grid.flat[max(0, len(shown) - columns) : len(shown)]:  # the lowest panels
        axes.tick_params(labelbottom=True)
        axes.set_xlabel(label(across))
    for axes in grid[:, 0]:
        axes.set_ylabel(label(down))
    _colour_bar(figure, grid, image, SPREAD, spread=True)
    _explain(figure, found)
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
    axes.set_facecolor(NOTHING)
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


def _spread_range(found: xr.Dataset) -> tuple[float, float]:
    """Return the ends of a range that contains the spreads and the threshold of stability."""
    spread = _spread(found)
    spread = spread[np.isfinite(spread)]
    low, high = (spread.min(), spread.max()) if spread.size else (STABLE_BELOW, STABLE_BELOW)
    return float(min(low, STABLE_BELOW / 10.0)), float(max(high, STABLE_BELOW * 10.0))


def _norm(values: FloatArray, least: float) -> Normalize:
    """Return a scale of the range of values, at least of the range `least`."""
    found = values[np.isfinite(values)]
    if not found.size:
        return Normalize(0.0, 1.0)
    if _wide(found):
        return LogNorm(found.min(), found.max())
    return Normalize(*_range(found, least))


def _wide(values: FloatArray) -> bool:
    return bool(values.min() > 0.0 and values.max() > 20.0 * values.min())


def _ticks(axes: Axes, which: str, axis: Axis) -> None:
    """Label evenly chosen values of an axis."""
    last = len(axis.values) - 1
    even = (count for count in TICKS if last % (count - 1) == 0)
    count = last + 1 if last < max(TICKS) else next(even, TICKS[0])
    places = sorted({round(k) for k in np.linspace(0, last, count)})
    labels = [tick(axis.values[k]) for k in places]
    axes.set(**{f"{which}ticks": places, f"{which}ticklabels": labels})
