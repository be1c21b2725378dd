# SPDX-License-Identifier: Apache-2.0
"""A formation seen from above, drawn to scale. A flock that has come apart has several panels."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.ticker import MaxNLocator, MultipleLocator

from flock_sim.physics.arrays import BoolArray, FloatArray
from flock_tools.figures.bird_outline import OUTLINE
from flock_tools.figures.plan.labels import (
    explain,
    mark_other_spans,
    number_birds,
    show_flight,
    tell_who_left,
)
from flock_tools.figures.plan.view import PlanView
from flock_tools.figures.style import DRAG_SAVED, FAINT, INK, PALE, saved_scale

_MOST_FIVES = 100.0
"""Largest range of drag reductions, in %, that has a tick every 5 %."""

_MOST_OUTLINED = 45
"""Largest number of birds for which a dark outline leaves their colour visible."""


def draw_formation(figure: Figure, axes: Axes, scale: Axes, view: PlanView) -> list[Text]:
    """Draw the birds to scale, on top of the start. Mark birds outside of the main panel.

    `axes` becomes the main panel and `scale` the scale of colours. Return the labels that may
    overlap, the most important first.
    """
    axes.set(
        xlim=(-0.5 * view.width, 0.5 * view.width),
        ylim=(view.bottom, view.top),
        ylabel="streamwise position $x_i$ (b)",
    )
    axes.set_aspect("equal")
    axes.add_collection(
        PolyCollection(
            _wings(view.across, view.start, view.span_ratio),
            facecolors="#e9ecee",
            edgecolors=PALE,
            linewidths=0.5,
        )
    )
    colours = ScalarMappable(saved_scale(view.saved), DRAG_SAVED)
    labels, numbers = tell_who_left(axes, view), []
    lowest = highest = axes
    for panel in (axes, *_other_panels(axes, view)):
        shown = view.within(*panel.get_ylim())
        panel.set_axisbelow(True)
        panel.grid(color="#eceff1", linewidth=0.7)
        _draw_birds(panel, view, shown, colours)
        mark_other_spans(panel, view, shown)
        numbers += number_birds(panel, view, shown)
        highest = max(panel, highest, key=_top)
        upper, lowest = sorted((panel, lowest), key=_top, reverse=True)
        if upper is not lowest:
            upper.spines.bottom.set_visible(False)
            upper.tick_params(bottom=False, labelbottom=False)
    lowest.set_xlabel("lateral position $y_i$, from the leader (b; a standard wing spans 2b)")
    started = (view.start >= view.bottom) & (view.start <= view.top)
    show_flight(axes)
    explain(highest, view, start=bool(started.any()) and len(view.start) > 1)
    _draw_scale(figure, scale, colours)
    numbers.sort(key=lambda number: number.rank)
    return [*labels, *(number.label for number in numbers)]


def _top(panel: Axes) -> float:
    return panel.get_ylim()[1]


def _other_panels(axes: Axes, view: PlanView) -> Iterator[Axes]:
    """Yield the panels of other parts, above and below the main one, on the same scale."""
    edges = [*view.panels, (view.bottom, view.top)]
    edges.sort()
    main = edges.index((view.bottom, view.top))
    for sign, panels in ((1, edges[main + 1 :]), (-1, edges[:main][::-1])):
        nearest, place = edges[main], 1.0 if sign > 0 else 0.0
        for bottom, top in panels:
            height = (top - bottom) / view.height
            between = view.between / view.height
            low = place + between if sign > 0 else place - between - height
            panel = axes.inset_axes((0.0, low, 1.0, height))
            panel.set(xlim=axes.get_xlim(), ylim=(bottom, top))
            panel.patch.set_visible(False)
            panel.yaxis.set_major_locator(MaxNLocator(3, steps=(1, 2, 5, 10), integer=True))
            panel.ticklabel_format(axis="y", useOffset=False)
            gap = bottom - nearest[1] if sign > 0 else nearest[0] - top
            _break_axis(panel, gap, above=sign < 0)
            yield panel
            nearest, place = (bottom, top), low + height if sign > 0 else low


def _break_axis(panel: Axes, gap: float, above: bool) -> None:
    """Tell how much of the axis along the flight is left out beside a panel."""
    panel.annotate(
        f"⁓⁓   {gap:.0f} b not shown   ⁓⁓",
        (0.5, 1.0 if above else 0.0),
        xytext=(0, 9 if above else -9),
        xycoords="axes fraction",
        textcoords="offset points",
        ha="center",
        va="center",
        fontsize=7.5,
        color=FAINT,
    )


def _draw_birds(axes: Axes, view: PlanView, here: BoolArray, colours: ScalarMappable) -> None:
    faces = np.where(
        np.isfinite(view.saved)[:, np.newaxis], colours.to_rgba(view.saved), (1.0, 1.0, 1.0, 1.0)
    )
    outlined = len(faces) <= _MOST_OUTLINED
    axes.add_collection(
        PolyCollection(
            _wings(view.across[here], view.along[here], view.span_ratio[here]),
            facecolors=faces[here],
            edgecolors=INK if outlined else faces[here],
            linewidths=0.4 if outlined else 0.8,
        )
    )


def _wings(across: FloatArray, along: FloatArray, span_ratio: FloatArray) -> list[FloatArray]:
    """Return the outline of each bird."""
    places = np.column_stack([across, along])
    return [place + ratio * OUTLINE for place, ratio in zip(places, span_ratio, strict=True)]


def _draw_scale(figure: Figure, axes: Axes, colours: ScalarMappable) -> None:
    """Draw the colour scale of drag reductions."""
    bar = figure.colorbar(colours, cax=axes)
    bar.set_label("drag reduction $\\eta_i$ (%)")
    bar.outline.set_visible(False)
    if np.ptp(colours.get_clim()) <= _MOST_FIVES:
        bar.locator = MultipleLocator(5.0)
    bar.update_ticks()
