# SPDX-License-Identifier: Apache-2.0
"""The stability diagram: the ratios of one bird that keep the formation (Fig. 4 of the paper)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.physics import formation
from flock_sim.theory.limit_search import End, Limits
from flock_tools.figures.style import (
    ALARM,
    COLUMN,
    FAINT,
    INK,
    PAGE,
    PRINT_STYLE,
    SMALL,
    flock_name,
)
from flock_tools.figures.table import Table


class Quantity(NamedTuple):
    """How a figure names the ratio that is modified."""

    axis: str
    equal: str
    """A ratio of 1."""


QUANTITIES = {
    "span": Quantity("span ratio $\\lambda$", "$\\lambda=1$"),
    "thrust": Quantity("thrust ratio $T/T_0$", "$T=T_0$"),
}

MOST_IN_COLUMN = 9
"""Largest number of birds in one column, with the gaps named at their ends."""

MOST_UPRIGHT = 20
"""Largest number of birds with upright names, on the width of a page."""

MOST_NAMED = 66
"""Largest number of birds with names."""

WORTH_ENLARGING = 0.6
"""Fraction of the searched interval below which the range of all ends is enlarged."""

NEAR = 0.04
"""Fraction of a panel's height within which a mark and a name overlap."""


def limits_table(limits: Sequence[Limits], configuration: FlockConfiguration) -> Table:
    """Return the limits, one bird per row; no lambda for a side without an end."""
    rows: list[Sequence[object]] = []
    for found in limits:
        ends: list[object] = []
        for end in (found.lower, found.upper):
            ends += [end.ratio, end.gap] if end else [None, None]
        rows.append([configuration.birds, configuration.coupling, found.bird, *ends, found.never])
    return Table(
        (
            "birds",
            "coupling",
            "modified_bird",
            "lower_span_ratio",
            "gap_that_opens_below",
            "upper_span_ratio",
            "gap_that_opens_above",
            "never",
        ),
        rows,
    )


def draw_limits(
    limits: Sequence[Limits],
    configuration: FlockConfiguration,
    low: float,
    high: float,
    of: str = "span",
) -> Figure:
    """Return the stability diagram: for each bird the interval of a ratio that keeps the formation.

    `limits` are of birds of `configuration`, a flock of one member, searched in [low, high]; `of`
    is the key of the ratio in QUANTITIES. If all ends lie close together, a second panel enlarges
    them. Each end is named by the gap that opens beyond it.
    """
    diagram = _Diagram(limits, configuration, low, high, of)
    panels = diagram.panels()
    width = COLUMN if len(limits) <= MOST_IN_COLUMN else PAGE
    heights = (1.7, 2.3) if len(panels) == 2 else (2.5,)
    with mpl.rc_context(PRINT_STYLE):
        figure = Figure(figsize=(width, sum(heights) + 1.0), layout="constrained")
        heading = flock_name(configuration, 0).replace(", $", "\n$", 1)
        figure.suptitle(heading, x=0.02, ha="left", fontsize=8)
        grid = figure.add_gridspec(len(heights), 1, height_ratios=heights)
        axes = figure.add_subplot(grid[0])
        diagram.draw(axes, *panels[0])
        if len(panels) == 2:
            axes.axhspan(*panels[1], color="#eef1f3", linewidth=0, zorder=0)
            axes.set_title("(a)")
            axes = figure.add_subplot(grid[1], sharex=axes)
            diagram.draw(axes, *panels[1])
            axes.set_title("(b) shaded part of (a)")
        diagram.name_ends(axes)
        leads = formation.leader(configuration.birds)
        axes.set_xlabel(f"modified bird $i$ (bird {leads} leads)")
        figure.legend(
            handles=diagram.legend(), loc="outside lower left", ncols=1 if width == COLUMN else 3
        )
    return figure


@dataclass(frozen=True)
class _Diagram:
    """The content of a stability diagram. Its panels show different ranges of the ratio."""

    limits: Sequence[Limits]
    configuration: FlockConfiguration
    low: float
    high: float
    of: str

    def present(self, limits: Limits) -> float:
        """Return the present ratio of the bird."""
        if self.of == "thrust":
            return 1.0
        return float(self.configuration.span_ratio[limits.bird - 1, 0])

    @property
    def ends(self) -> list[tuple[Limits, End, int]]:
        """All ends that were found, each with its bird and the outward direction."""
        sides = [((found, found.lower, -1), (found, found.upper, 1)) for found in self.limits]
        return [(*side[:1], end, side[2]) for two in sides for side in two if (end := side[1])]

    @property
    def sideways(self) -> bool:
        """Whether the names of gaps are rotated by 90 degrees, to save room."""
        return len(self.limits) > MOST_UPRIGHT

    def panels(self) -> list[tuple[float, float]]:
        """Return the ranges of the ratio that are shown: the searched range, and that of all ends.

        The second range is only returned if it is small enough. The last range has room for names.
        """
        whole = (self.low, self.high)
        places = [end.ratio for _, end, _ in self.ends]
        if not places:
            return [whole]
        room = 0.3 if self.sideways else 0.15
        inner = (*places, *(self.present(found) for found in self.limits))
        margin = max(room * (max(inner) - min(inner)), 0.005 * (self.high - self.low))
        bottom, top = min(inner) - margin, max(inner) + margin
        if top - bottom < WORTH_ENLARGING * (self.high - self.low):
            return [whole, (bottom, top)]
        margin = room * (self.high - self.low)
        return [(min(self.low, min(places) - margin), max(self.high, max(places) + margin))]

    def draw(self, axes: Axes, bottom: float, top: float) -> None:
        """Draw the intervals as far as they lie between `bottom` and `top`."""
        birds = [found.bird for found in self.limits]
        axes.set(
            xlim=(min(birds) - 0.7, max(birds) + 0.7),
            ylim=(bottom, top),
            ylabel=QUANTITIES[self.of].axis,
        )
        if len(birds) <= MOST_UPRIGHT:
            axes.set_xticks(birds)
        else:
            axes.xaxis.set_major_locator(MaxNLocator(13, integer=True, steps=(1, 2, 5, 10)))
        axes.yaxis.set_major_locator(MaxNLocator(6, steps=(1, 2.5, 5, 10)))
        axes.grid(axis="y")
        if bottom <= 1.0 <= top:
            axes.axhline(1.0, color=FAINT, linewidth=0.8, linestyle=(0, (4, 2)), zorder=1)
            axes.annotate(
                QUANTITIES[self.of].equal,
                (1.0, 1.0),
                xytext=(2, 0),
                xycoords=("axes fraction", "data"),
                textcoords="offset points",
                va="center",
                fontsize=SMALL,
            )
        for found in self.limits:
            self._interval(axes, found, bottom, top)

    def _interval(self, axes: Axes, found: Limits, bottom: float, top: float) -> None:
        present = self.present(found)
        if found.never:
            place = min(max(present, bottom), top)
            axes.plot(found.bird, place, "x", color=INK, markersize=5, clip_on=False, zorder=4)
            return
        if bottom <= present <= top and present != 1.0:
            axes.plot(found.bird, present, "o", color=INK, markerfacecolor="white", zorder=4)
        low, high = found.searched or (self.low, self.high)
        first = found.lower.ratio if found.lower else low
        last = found.upper.ratio if found.upper else high
        shown = [min(max(ratio, bottom), top) for ratio in (first, last)]
        red: dict[str, Any] = {"color": ALARM, "clip_on": False, "zorder": 3}
        axes.plot([found.bird] * 2, shown, linewidth=self._thickness, solid_capstyle="butt", **red)
        sides = ((first, shown[0], found.lower, "v"), (last, shown[1], found.upper, "^"))
        for ratio, place, end, mark in sides:
            if end is None and place == ratio and self._is_bound(ratio):
                continue
            if end is None or place != ratio:
                axes.plot(found.bird, place, mark, markersize=4, markeredgewidth=0, **red)
            else:
                axes.plot(found.bird, ratio, "_", markersize=2.5 * self._thickness, **red)

    def _is_bound(self, ratio: float) -> bool:
        """Return whether a search that ended at `ratio` leaves nothing beyond.

        Vortices would meet if it ended within the requested range, and no bird has less thrust
        than none.
        """
        return self.low < ratio < self.high or (self.of == "thrust" and ratio == 0.0)

    def _extends(self, found: Limits) -> bool:
        """Return whether the interval of a bird extends beyond the requested range."""
        low, high = found.searched or (self.low, self.high)
        return (found.lower is None and not self._is_bound(low)) or (
            found.upper is None and not self._is_bound(high)
        )

    @property
    def _thickness(self) -> float:
        return 2.4 if len(self.limits) <= MOST_UPRIGHT else 1.6

    def name(self, end: End) -> str:
        """Return the birds that part beyond an end, with a dash if bars of names would join."""
        if not end.gap:
            return "$U^*$"
        return f"{end.gap}{'–' if self.sideways else '|'}{end.gap + 1}"

    def name_ends(self, axes: Axes) -> None:
        """Write beside each end the gap that opens beyond it."""
        if len(self.limits) > MOST_NAMED:
            return
        bottom, top = axes.get_ylim()
        for found, end, outwards in self.ends:
            beside = abs(self.present(found) - end.ratio) < NEAR * (top - bottom)
            marked = beside and self.present(found) != 1.0
            axes.annotate(
                self.name(end),
                (found.bird, end.ratio),
                xytext=(0, (6 if marked else 3) * outwards),
                textcoords="offset points",
                ha="center",
                va="bottom" if outwards > 0 else "top",
                rotation=90 if self.sideways else 0,
                fontsize=SMALL,
                bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.4},
                zorder=2,
            )

    def legend(self) -> list[Line2D]:
        """Return the legend of the marks in use."""

        def mark(label: str, marker: str, **how: Any) -> Line2D:
            style = {"color": ALARM, "linestyle": "none", **how}
            return Line2D([], [], marker=marker, label=label, **style)

        kept = [found for found in self.limits if not found.never]
        marks = []
        if kept:
            marks.append(
                Line2D([], [], color=ALARM, linewidth=self._thickness, label="formation exists")
            )
        if any(end.gap for _, end, _ in self.ends) and len(self.limits) <= MOST_NAMED:
            text = "birds 1 and 2 separate beyond this end"
            sign = f"$\\mathrm{{{self.name(End(1.0, 1))}}}$"
            marks.append(mark(text, sign, color=INK, markersize=11, markeredgewidth=0.2))
        if any(not end.gap for _, end, _ in self.ends) and len(self.limits) <= MOST_NAMED:
            text = "no speed balances thrust and drag beyond"
            marks.append(mark(text, "$U^*$", color=INK, markersize=9, markeredgewidth=0.2))
        if any(self._extends(found) for found in kept):
            marks.append(mark("interval extends beyond the figure", "^", markeredgewidth=0))
        if len(kept) < len(self.limits):
            text = f"no formation from {self.low:g} to {self.high:g}"
            marks.append(mark(text, "x", color=INK, markersize=5))
        if any(self.present(found) != 1.0 for found in kept):
            text = "present $\\lambda_i$"
            marks.append(mark(text, "o", color=INK, markerfacecolor="white"))
        return marks
