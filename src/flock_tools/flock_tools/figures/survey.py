# SPDX-License-Identifier: Apache-2.0
"""The figure of a survey: fractions of random flocks that can fly, and that break by position."""

from __future__ import annotations

from collections.abc import Sequence

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, MaxNLocator, PercentFormatter

from flock_tools.experiments.random_flocks import Population
from flock_tools.figures.style import (
    BLUE,
    COUPLING_NAMES,
    GREEN,
    ORANGE,
    PAGE,
    PRINT_STYLE,
    SKY,
    SMALL,
    VERMILLION,
)

COLOURS = (BLUE, VERMILLION, GREEN, ORANGE, SKY)
MARKERS = "osD^v"


def draw_survey(populations: Sequence[Population], coupling: str = "nearest") -> Figure:
    """Return the figure: (a) flocks that can fly against spread, (b) those that break by position.

    `coupling` is that of the flocks, for the title.
    For each size of flock, (b) shows the spread at which closest to half of the flocks can fly.
    """
    sizes = sorted({population.birds for population in populations})
    with mpl.rc_context(PRINT_STYLE):
        figure = Figure(figsize=(PAGE, 2.85), layout="constrained")
        left, right = figure.subplots(1, 2)
        for number, birds in enumerate(sizes):
            kind = {
                "color": COLOURS[number % len(COLOURS)],
                "marker": MARKERS[number % len(MARKERS)],
                "linestyle": "-" if number < len(COLOURS) else "--",
                "markerfacecolor": "white",
            }
            same = [population for population in populations if population.birds == birds]
            same.sort(key=lambda population: population.distribution.spread)
            _fractions(left, same, {**kind, "label": f"N = {birds}"})
            half = min(same, key=lambda population: abs(population.flying.value - 0.5))
            spread = f"{half.distribution.spread:.3g}"
            _positions(right, half, {**kind, "label": f"N = {birds}, spread {spread}"})
        figure.suptitle(_title(populations, coupling), x=0.02, ha="left", fontsize=8)
        spreads = {population.distribution.spread for population in populations}
        if max(spreads) > 8.0 * min(spreads):
            left.set_xscale("log")
            left.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            left.xaxis.set_major_formatter("{x:g}")
            left.xaxis.set_minor_formatter("")
        scale = ", logarithmic" if left.get_xscale() == "log" else ""
        left.set(
            title="(a)",
            xlabel=f"spread of span ratios $\\lambda$ (standard deviation{scale})",
            ylabel="flocks that can fly in formation",
            ylim=(-0.03, 1.03),
        )
        right.set(
            title="(b)",
            xlabel=_positions_label(sizes),
            ylabel="flocks that can't",
            ylim=(-0.03, 1.03),
        )
        right.xaxis.set_major_locator(MaxNLocator(integer=True))
        for axes, title in ((left, None), (right, "bars: 95 % confidence")):
            axes.yaxis.set_major_formatter(PercentFormatter(1.0))
            axes.grid(visible=True)
            axes.legend(loc="best", fontsize=SMALL, title=title)
    return figure


def _title(populations: Sequence[Population], coupling: str) -> str:
    between = populations[0].distribution.between
    kind = f"uniform from {between[0]:g} to {between[1]:g}" if between else "normal about 1"
    return f"random span ratios, {kind}; {COUPLING_NAMES[coupling]} coupling, exact links"


def _positions_label(sizes: Sequence[int]) -> str:
    """Return the label of wing positions; the last one of an even flock is that of two birds."""
    odd, even = any(birds % 2 for birds in sizes), any(birds % 2 == 0 for birds in sizes)
    last = "last: leader" if odd else "last: middle two"
    if odd and even:
        last = "last: leader, or middle two"
    return f"wing position of the smallest bird (1: tail, {last})"


def _fractions(axes: Axes, populations: Sequence[Population], kind: dict[str, object]) -> None:
    _bars(
        axes,
        [population.distribution.spread for population in populations],
        [population.flying.value for population in populations],
        [population.flying.interval for population in populations],
        kind,
    )


def _positions(axes: Axes, population: Population, kind: dict[str, object]) -> None:
    broken = population.broken_by_weakest
    _bars(
        axes,
        list(range(1, len(broken) + 1)),
        [fraction.value for fraction in broken],
        [fraction.interval for fraction in broken],
        kind,
    )


def _bars(
    axes: Axes,
    across: Sequence[float],
    values: Sequence[float],
    intervals: Sequence[tuple[float, float]],
    kind: dict[str, object],
) -> None:
    """Draw values with their confidence intervals."""
    found = np.array(values)
    ends = np.array(intervals).T
    reach = np.clip(np.stack([found - ends[0], ends[1] - found]), 0.0, None)
    axes.errorbar(across, found, yerr=np.nan_to_num(reach), capsize=1.5, elinewidth=0.6, **kind)  # type: ignore[arg-type]
