# SPDX-License-Identifier: Apache-2.0
"""Numbers, marks and explanations of the birds of a formation seen from above."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patheffects import withStroke
from matplotlib.text import Text

from flock_sim.physics import formation
from flock_sim.physics.arrays import BoolArray, IntArray
from flock_tools.figures.plan.view import PlanView
from flock_tools.figures.style import BLUE, FAINT, INK, VERMILLION

_MOST_NUMBERS = 15
"""Largest number of birds for which each has its number."""

_MOST_DIGITS = 1e6
"""Distance in b from which on a position is written with an exponent."""

_ROOM = 0.018
"""Least distance of the positions of two birds that are written on their own, over the width."""

_ABOVE = 0.15
"""Distance from the middle of a bird to its nose, over its semi-span."""

LARGER, SMALLER = ("+", VERMILLION), ("_", BLUE)
"""Marks and colours of birds whose span is not the standard one."""

_HALO = withStroke(linewidth=2.0, foreground="white")


class Number(NamedTuple):
    """The number of a bird. If two overlap, the one of lower rank is written."""

    rank: int
    label: Text


def number_birds(axes: Axes, view: PlanView, here: BoolArray) -> list[Number]:
    """Write the birds' numbers behind them. A large flock has some numbers, outside of it."""
    birds = len(view.across)
    leader = formation.leader(birds)
    small = birds <= _MOST_NUMBERS
    every = 1 if small else 5 if birds <= 60 else 10
    numbers = []
    for i in np.flatnonzero(here):
        bird = int(i) + 1
        to_named = min(abs(bird - other) for other in (1, leader, birds))
        if to_named and (bird % every or to_named < every / 2):
            continue
        side = int(np.sign(bird - leader))
        label = axes.annotate(
            str(bird),
            (view.across[i], view.along[i] - (0.23 * view.span_ratio[i] if small else 0.0)),
            xytext=(0, -2) if small else (2 * side, 3),
            textcoords="offset points",
            ha="center" if small else {-1: "right", 0: "center", 1: "left"}[side],
            va="top" if small else "bottom",
            fontsize=8.5 if small else 7.5,
            fontweight="bold" if bird == leader else "normal",
            path_effects=[_HALO],
        )
        numbers.append(Number(min(to_named, 1), label))
    return numbers


def mark_other_spans(axes: Axes, view: PlanView, here: BoolArray) -> None:
    """Mark each bird that is larger or smaller than a standard one, ahead of it."""
    for (mark, colour), other in (
        (LARGER, view.span_ratio > 1.0),
        (SMALLER, view.span_ratio < 1.0),
    ):
        marked = here & other
        if not marked.any():
            continue
        axes.plot(
            view.across[marked],
            (view.along + _ABOVE * view.span_ratio)[marked] + 0.012 * view.width,
            mark,
            color=colour,
            markersize=6.0,
            markeredgewidth=1.6,
            clip_on=False,
            path_effects=[withStroke(linewidth=3.0, foreground="white")],
        )


def tell_who_left(axes: Axes, view: PlanView) -> list[Text]:
    """Mark the birds outside of the main panel, with their positions. Return the labels."""
    known = np.isfinite(view.along)
    labels: list[Text] = []
    for behind in (True, False):
        left = known & (view.along < view.bottom if behind else view.along > view.top)
        edge = view.bottom if behind else view.top
        for birds in _side_by_side(view, left):
            across = float(view.across[birds].mean())
            mark = "v" if behind else "^"
            axes.plot(across, edge, mark, color=INK, markersize=6, clip_on=False, zorder=5)
            label = axes.annotate(
                _told(view, birds),
                (across, edge),
                xytext=(0, 7 if behind else -7),
                textcoords="offset points",
                ha="center",
                va="bottom" if behind else "top",
                rotation=90,
                fontsize=7.5,
                bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.85, "pad": 1.0},
            )
            labels.append(label)
    if not known.all():
        lost = ", ".join(str(i + 1) for i in np.flatnonzero(~known))
        text = f"without a finite position: {lost}" if known.any() else "no finite position"
        labels.append(axes.text(0.5, 0.5, text, transform=axes.transAxes, ha="center"))
    return labels


def _side_by_side(view: PlanView, left: BoolArray) -> list[IntArray]:
    """Return the indices of `left`, those of birds together that have no room for two labels."""
    indices = np.flatnonzero(left)
    if not len(indices):
        return []
    apart = np.diff(view.across[indices]) >= _ROOM * view.width
    return np.split(indices, np.flatnonzero(apart) + 1)


def _told(view: PlanView, birds: IntArray) -> str:
    first, last = int(birds[0]) + 1, int(birds[-1]) + 1
    if first == last:
        return f"{first} at {_distance(view.along[birds[0]])} b".replace("-", "−")
    name = f"{first} to {last}"
    if last - first >= len(birds):
        name = f"{len(birds)} of {name}"
    low, high = (_distance(end(view.along[birds])) for end in (np.min, np.max))
    return f"{name} at {low} to {high} b".replace("-", "−")


def _distance(along: float) -> str:
    return f"{along:.0f}" if abs(along) < _MOST_DIGITS else f"{along:.3g}"


def show_flight(axes: Axes) -> None:
    """Draw the direction of flight."""
    axes.annotate(
        "flight",
        (0.025, 0.97),
        xytext=(0, -34),
        xycoords="axes fraction",
        textcoords="offset points",
        ha="center",
        fontsize=7.5,
        color=FAINT,
        arrowprops={"arrowstyle": "->", "color": FAINT, "linewidth": 0.9},
    )


def explain(axes: Axes, view: PlanView, start: bool) -> None:
    """Name the grey birds, if any, and the marks of other spans, above a panel."""
    told = ["grey: the start"] if start else []
    if (view.span_ratio > 1.0).any():
        told.append("+ larger bird, $\\lambda$ > 1")
    if (view.span_ratio < 1.0).any():
        told.append("− smaller bird, $\\lambda$ < 1")
    if not told:
        return
    axes.annotate(
        "    ".join(told),
        (0.0, 1.0),
        xytext=(0, 3),
        xycoords="axes fraction",
        textcoords="offset points",
        fontsize=7.5,
        color=FAINT,
    )
