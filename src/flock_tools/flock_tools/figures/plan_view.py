# SPDX-License-Identifier: Apache-2.0
"""A formation seen from above, drawn to scale."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.ticker import MultipleLocator

from flock_sim.analysis.metrics import Metrics
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.physics import formation
from flock_sim.physics.arrays import FloatArray
from flock_tools.figures.bird_outline import OUTLINE
from flock_tools.figures.style import DRAG_SAVED, FAINT, INK, PALE, saved_scale

_NARROWEST = 10.0
"""Least width that is shown, in b, so that a few birds are not drawn too large."""

_MOST_NUMBERS = 15
"""Largest number of birds for which each has its number."""

_FARTHEST = 1e9
"""Largest distance of the view from the leader, in b: rounding moves no bird visibly there."""

_MOST_DIGITS = 1e6
"""Distance in b from which on a position is written with an exponent."""

_MOST_FIVES = 100.0
"""Largest range of drag reductions, in %, that has a tick every 5 %."""

_MOST_OUTLINED = 45
"""Largest number of birds for which a dark outline leaves their colour visible."""


@dataclass(frozen=True)
class PlanView:
    """One flock as it is drawn; arrays of shape (birds,), lengths in b from the leader."""

    across: FloatArray
    along: FloatArray
    start: FloatArray
    """`along` at the start of the flight."""
    span_ratio: FloatArray
    saved: FloatArray
    """Drag reduction, in %."""
    bottom: float
    top: float
    """Upper end of the range shown along the flight; `bottom` is its lower end."""

    @classmethod
    def of(cls, configuration: FlockConfiguration, metrics: Metrics, m: int) -> PlanView:
        """Return the view of the flock with index `m`.

        If the flock has come apart, the view is around the bird in the middle, or around the start
        if that bird is too far from the leader.
        """
        birds = configuration.birds
        start = np.array([formation.start_position(bird, birds) for bird in range(1, birds + 1)])
        along = metrics.position[m]
        there = along[np.isfinite(along)]
        middle = formation.middle_position(there) if len(there) else 0.0
        if abs(middle) > _FARTHEST:
            middle = 0.0
        places = np.append(there, start)
        shown = places[np.abs(places - middle) <= np.ptp(start) + 3.0]
        return cls(
            across=metrics.lateral[m],
            along=along,
            start=start,
            span_ratio=configuration.span_ratio[:, m],
            saved=100.0 * metrics.drag_reduction[m],
            bottom=float(shown.min()) - 1.4,
            top=float(shown.max()) + 1.2 + 0.03 * float(np.ptp(start)),
        )

    @property
    def width(self) -> float:
        """Width of the view across the flight, in b."""
        flock = 2.0 * float((np.abs(self.across) + self.span_ratio).max())
        return max(_NARROWEST, 1.05 * flock + 1.0)

    @property
    def height(self) -> float:
        """Height of the view along the flight, in b."""
        return self.top - self.bottom


def draw_formation(figure: Figure, axes: Axes, view: PlanView) -> None:
    """Draw the birds to scale, on top of the start. Mark birds outside of the view."""
    axes.set(
        xlim=(-0.5 * view.width, 0.5 * view.width),
        ylim=(view.bottom, view.top),
        xlabel="lateral position $y_i$, from the leader (b; a standard wing spans 2b)",
        ylabel="streamwise position $x_i$ (b)",
    )
    axes.set_aspect("equal")
    axes.set_axisbelow(True)
    axes.grid(color="#eceff1", linewidth=0.7)
    axes.add_collection(
        PolyCollection(
            _wings(view.across, view.start, view.span_ratio),
            facecolors="#e9ecee",
            edgecolors=PALE,
            linewidths=0.5,
        )
    )
    here = (view.along >= view.bottom) & (view.along <= view.top)
    colours = ScalarMappable(saved_scale(view.saved), DRAG_SAVED)
    faces = np.where(
        np.isfinite(view.saved)[:, np.newaxis], colours.to_rgba(view.saved), (1.0, 1.0, 1.0, 1.0)
    )
    axes.add_collection(
        PolyCollection(
            _wings(view.across[here], view.along[here], view.span_ratio[here]),
            facecolors=faces[here],
            edgecolors=INK if len(faces) <= _MOST_OUTLINED else faces[here],
            linewidths=0.4 if len(faces) <= _MOST_OUTLINED else 0.8,
        )
    )
    _number(axes, view, here)
    _tell_who_left(axes, view, here)
    started = (view.start >= view.bottom) & (view.start <= view.top)
    _explain(axes, start=bool(started.any()) and len(faces) > 1)
    bar = figure.colorbar(colours, ax=axes, shrink=0.8, aspect=22, pad=0.015)
    bar.set_label("drag reduction $\\eta_i$ (%)")
    bar.outline.set_visible(False)
    if np.ptp(colours.get_clim()) <= _MOST_FIVES:
        bar.locator = MultipleLocator(5.0)
    bar.update_ticks()


def _wings(across: FloatArray, along: FloatArray, span_ratio: FloatArray) -> list[FloatArray]:
    """Return the outline of each bird."""
    places = np.column_stack([across, along])
    return [place + ratio * OUTLINE for place, ratio in zip(places, span_ratio, strict=True)]


def _number(axes: Axes, view: PlanView, here: npt.NDArray[np.bool_]) -> None:
    """Write the birds' numbers behind them. A large flock has some numbers, outside of it."""
    birds = len(view.across)
    leader = formation.leader(birds)
    small = birds <= _MOST_NUMBERS
    every = 1 if small else 5 if birds <= 60 else 10
    for i in np.flatnonzero(here):
        bird = int(i) + 1
        to_named = min(abs(bird - other) for other in (1, leader, birds))
        if to_named and (bird % every or to_named < every / 2):
            continue
        side = int(np.sign(bird - leader))
        axes.annotate(
            str(bird),
            (view.across[i], view.along[i] - (0.23 * view.span_ratio[i] if small else 0.0)),
            xytext=(0, -2) if small else (2 * side, 3),
            textcoords="offset points",
            ha="center" if small else {-1: "right", 0: "center", 1: "left"}[side],
            va="top" if small else "bottom",
            fontsize=8.5 if small else 7.5,
            fontweight="bold" if bird == leader else "normal",
        )


def _tell_who_left(axes: Axes, view: PlanView, here: npt.NDArray[np.bool_]) -> None:
    """Mark the birds outside of the view, with their positions."""
    known = np.isfinite(view.along)
    for i in np.flatnonzero(~here & known):
        behind = view.along[i] < view.bottom
        edge = view.bottom if behind else view.top
        mark = "v" if behind else "^"
        axes.plot(view.across[i], edge, mark, color=INK, markersize=6, clip_on=False, zorder=5)
        axes.annotate(
            f"{i + 1} at {_distance(view.along[i])} b".replace("-", "−"),
            (view.across[i], edge),
            xytext=(0, 7 if behind else -7),
            textcoords="offset points",
            ha="center",
            va="bottom" if behind else "top",
            rotation=90,
            fontsize=7.5,
            bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.85, "pad": 1.0},
        )
    if not known.all():
        lost = ", ".join(str(i + 1) for i in np.flatnonzero(~known))
        text = f"without a finite position: {lost}" if known.any() else "no finite position"
        axes.text(0.5, 0.5, text, transform=axes.transAxes, ha="center")


def _distance(along: float) -> str:
    return f"{along:.0f}" if abs(along) < _MOST_DIGITS else f"{along:.3g}"


def _explain(axes: Axes, start: bool) -> None:
    """Draw the direction of flight, and name the grey birds."""
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
    if start:
        axes.text(
            0.5,
            0.03,
            "grey: the start",
            transform=axes.transAxes,
            ha="center",
            fontsize=7.5,
            color=FAINT,
        )
