# SPDX-License-Identifier: Apache-2.0
"""The figure of `arrange`: speeds and margins of all orders, and the best orders bird by bird."""

from __future__ import annotations

from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from flock_sim.physics import formation
from flock_sim.theory.arrangement.arrange import EXACT, Arranged, Arrangement
from flock_tools.figures.style import (
    BLUE,
    COUPLING_NAMES,
    FAINT,
    GREEN,
    INK,
    ORANGE,
    PAGE,
    PALE,
    PRINT_STYLE,
    SMALL,
    VERMILLION,
)

KINDS: dict[str, tuple[str, str, str]] = {
    "fastest": ("fastest", VERMILLION, "^"),
    "fastest_flying": ("fastest that flies", BLUE, "s"),
    "firmest": ("firmest", GREEN, "o"),
    "closest": ("closest to flying", ORANGE, "D"),
}
"""Name, colour and mark of each result."""

MOST_POINTS = 3000
"""Largest number of orders that are drawn as points; more are drawn as a density."""

MOST_NUMBERED = 20
"""Largest number of birds for which each place has a number."""


def draw_arrangement(found: Arrangement) -> Figure:
    """Return the figure: (a) the margin and speed of each order, (b, ...) the best orders."""
    results = {name: result for name in KINDS if (result := getattr(found, name)) is not None}
    with mpl.rc_context(PRINT_STYLE):
        figure = Figure(figsize=(PAGE, 3.6), layout="constrained")
        figure.suptitle(_heading(found), x=0.01, ha="left", fontsize=8)
        rows = max(1, len(results))
        grid = figure.add_gridspec(rows, 2, width_ratios=(1.0, 1.15))
        _draw_orders(figure.add_subplot(grid[:, 0]), found, results)
        ratio = found.kinds.ratio
        room = max(0.08 * float(ratio[-1] - ratio[0]), 0.005)
        for row, (name, result) in enumerate(results.items()):
            axes = figure.add_subplot(grid[row, 1])
            axes.set_ylim(float(ratio[0]) - 2.0 * room, float(ratio[-1]) + room)
            _draw_order(axes, "bcde"[row], name, result)
            if row < rows - 1:
                axes.set_xticklabels([])
            else:
                axes.set_xlabel(f"place (bird {formation.leader(len(result.order))} leads)")
    return figure


def _heading(found: Arrangement) -> str:
    coupling = COUPLING_NAMES[found.kinds.coupling]
    count = f"{found.orders:,}" if found.orders < 10**15 else f"{float(found.orders):.3g}"
    orders = f"{count} order{'s' * (found.orders > 1)}"
    text = f"{found.kinds.birds} birds, {coupling} coupling: {orders}"
    if found.flying is not None:
        text += f", {f'{found.flying:,}' if found.flying else 'none'} can fly in formation"
    return text if found.method == EXACT else f"{text}; by local search"


def _draw_orders(axes: Axes, found: Arrangement, results: dict[str, Arranged]) -> None:
    """Draw all orders if they were computed, and mark the results."""
    if found.speed is not None and found.margin is not None:
        known = np.isfinite(found.speed)
        margin, speed = found.margin[known], found.speed[known]
        if len(margin) > MOST_POINTS:
            axes.hexbin(
                margin, speed, gridsize=60, bins="log", mincnt=1, cmap="Greys", linewidths=0.1,
                vmin=0.3, rasterized=True,
            )  # fmt: skip
        else:
            axes.plot(margin, speed, ".", color=FAINT, markersize=3.5, markeredgewidth=0)
    drawn: dict[tuple[float, ...], float] = {}
    for name, result in results.items():
        text, colour, mark = KINDS[name]
        # One order can be several results: their marks are drawn around each other.
        size = drawn[key] + 3.5 if (key := tuple(result.order)) in drawn else 5.5
        drawn[key] = size
        style: dict[str, Any] = {"markerfacecolor": "none", "markeredgewidth": 1.4}
        axes.plot(
            result.margin, result.speed, mark, color=colour, markersize=size, label=text,
            clip_on=False, zorder=4, **style,
        )  # fmt: skip
    axes.set(
        title="(a) " + _content(found),
        xlabel="margin",
        ylabel="speed $U^*$ ($U_{\\min}$)",
    )
    axes.margins(0.06)
    axes.ticklabel_format(useOffset=False)
    low, high = axes.get_xlim()
    if high > 0.0:
        axes.axvspan(max(0.0, low), high, color="#eef3f0", linewidth=0, zorder=0)
        axes.set_xlim(low, high)
        axes.text(
            1.0, 1.0, "can fly ", transform=axes.transAxes, ha="right", va="bottom",
            fontsize=SMALL, color=INK,
        )  # fmt: skip
    axes.grid(visible=True)
    if results:
        axes.legend(loc="lower left")


def _content(found: Arrangement) -> str:
    """Return what the panel of orders shows."""
    if found.speed is None:
        return "the best orders"
    return "all orders" + " (dark: many)" * (len(found.speed) > MOST_POINTS)


def _draw_order(axes: Axes, letter: str, name: str, result: Arranged) -> None:
    """Draw the span ratio of each bird of an order as a bar from the standard span."""
    text, colour, _ = KINDS[name]
    place = np.arange(1, len(result.order) + 1)
    bottom = axes.get_ylim()[0]
    axes.bar(place, result.order - bottom, bottom=bottom, width=0.78, color=colour, alpha=0.75)
    if bottom < 1.0 < axes.get_ylim()[1]:
        axes.axhline(1.0, color=PALE, linewidth=0.7, linestyle=(0, (4, 2)), zorder=0)
    margin = f"{result.margin:.4f}".replace("-", "−")
    axes.set_title(f"({letter}) {text}: $U^*$ = {result.speed:.5f}, margin {margin}")
    axes.set_ylabel("$\\lambda$")
    axes.yaxis.set_major_locator(MaxNLocator(4, steps=(1, 2, 2.5, 5, 10)))
    axes.set_xlim(0.4, len(place) + 0.6)
    if len(place) <= MOST_NUMBERED:
        axes.set_xticks(place)
    else:
        axes.xaxis.set_major_locator(MaxNLocator(10, integer=True))
