# SPDX-License-Identifier: Apache-2.0
"""Figure 3 of the paper: steady flocks of equal birds, for both couplings."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from flock_sim.configuration.choices import COUPLINGS
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.physics.arrays import FloatArray
from flock_sim.physics.flock import Flock
from flock_sim.theory.equilibrium import Equilibrium, equilibrium
from flock_tools.figures.style import (
    BLUE,
    COLUMN,
    COUPLING_NAMES,
    FAINT,
    GREEN,
    INK,
    ORANGE,
    PRINT_STYLE,
    SMALL,
    VERMILLION,
)
from flock_tools.figures.table import Table

SIZES = range(3, 52, 2)
"""Numbers of birds of the flocks."""

SHOWN = {3: (ORANGE, "D"), 7: (VERMILLION, "s"), 13: (BLUE, "o"), 21: (GREEN, "^")}
"""Numbers of birds whose configurations are shown, and the colour and symbol of each."""

LINES: dict[str, Any] = {"all": "-", "nearest": (0, (3.5, 1.8))}
"""Line of each coupling."""

Mean = Callable[[str, Sequence[int]], FloatArray]
"""A function of a coupling and numbers of birds that returns a mean over each flock."""


@dataclass(frozen=True)
class SteadyFlocks:
    """Steady states of homogeneous flocks, by coupling and number of birds."""

    states: dict[tuple[str, int], Equilibrium]

    def sizes(self) -> list[int]:
        """Return the numbers of birds, ascending."""
        return sorted({birds for _, birds in self.states})

    def speed(self, coupling: str, sizes: Sequence[int]) -> FloatArray:
        """Return U* of flocks of these sizes, in U_min."""
        return np.array([self.states[coupling, birds].speed[0] for birds in sizes])

    def drag_reduction(self, coupling: str, sizes: Sequence[int]) -> FloatArray:
        """Return the mean of eta_i over the birds of flocks of these sizes."""
        states = [self.states[coupling, birds] for birds in sizes]
        return np.array([state.drag_reduction.mean() for state in states])

    def saved(self, coupling: str, sizes: Sequence[int]) -> FloatArray:
        """Return the mean of eta_i over the birds of flocks of these sizes, in %."""
        return 100.0 * self.drag_reduction(coupling, sizes)

    def configurations(self) -> Table:
        """Return the data of panel (a): the position of each bird."""
        rows: list[Sequence[object]] = []
        for (coupling, birds), state in self.states.items():
            if birds in SHOWN:
                places = zip(0.5 * state.position[:, 0], 0.5 * state.lateral[:, 0])
                rows += [[coupling, birds, i, x, y] for i, (x, y) in enumerate(places, start=1)]
        return Table(("coupling", "birds", "bird", "x_over_2b", "y_over_2b"), rows)

    def means(self) -> Table:
        """Return the data of panels (b) and (c): speeds and mean drag reductions of flocks."""
        rows: list[Sequence[object]] = [
            [coupling, birds, state.speed[0], state.drag_reduction.mean()]
            for (coupling, birds), state in self.states.items()
        ]
        return Table(("coupling", "birds", "speed_over_Umin", "mean_drag_reduction"), rows)


def steady_flocks(sizes: Sequence[int] = SIZES) -> SteadyFlocks:
    """Return the steady states of flocks of these sizes."""
    states = {
        (coupling, birds): equilibrium(Flock.of(FlockConfiguration(birds=birds, coupling=coupling)))
        for coupling in COUPLINGS
        for birds in sizes
    }
    return SteadyFlocks(states)


def draw_steady(data: SteadyFlocks) -> Figure:
    """Return figure 3."""
    with mpl.rc_context(PRINT_STYLE):
        figure = Figure(figsize=(COLUMN, 6.4), layout="constrained")
        grid = figure.add_gridspec(3, 1, height_ratios=(2.5, 1.8, 1.8))
        _configurations(figure.add_subplot(grid[0]), data)
        axes = figure.add_subplot(grid[1])
        _means(axes, data.speed, data.sizes())
        axes.set(title="(b)", ylim=(1.1, 1.36), ylabel="steady speed $U^*$ ($U_\\mathrm{min}$)")
        axes = figure.add_subplot(grid[2])
        _means(axes, data.saved, data.sizes())
        axes.set(title="(c)", ylim=(0.0, 19.0), ylabel="mean drag reduction $\\eta$ (%)")
    return figure


def _configurations(axes: Axes, data: SteadyFlocks) -> None:
    """Draw panel (a), with open symbols and dashes for nearest-neighbour coupling."""
    for birds, (colour, symbol) in SHOWN.items():
        for coupling, line in LINES.items():
            state = data.states[coupling, birds]
            axes.plot(
                state.lateral[:, 0],
                state.position[:, 0],
                color=colour,
                linestyle=line,
                marker=symbol,
                markerfacecolor=_face(coupling, colour),
            )
    axes.set(
        title="(a)",
        xlabel="lateral position $y_i$ (b)",
        ylabel="streamwise position $x_i$ (b)",
    )
    axes.margins(y=0.06)
    named = [
        Line2D([], [], color=colour, marker=symbol, linestyle="none", label=f"$N={birds}$")
        for birds, (colour, symbol) in SHOWN.items()
    ]
    named += [
        Line2D(
            [],
            [],
            color=INK,
            linestyle=line,
            marker="o",
            markerfacecolor=_face(coupling, INK),
            label=COUPLING_NAMES[coupling],
        )
        for coupling, line in LINES.items()
    ]
    axes.legend(handles=named, loc="lower center")


def _means(axes: Axes, mean: Mean, sizes: Sequence[int]) -> None:
    """Draw a mean over the birds against their number. The inset shows the flocks of panel (a)."""
    inset = axes.inset_axes((0.36, 0.15, 0.63, 0.48))
    for coupling, line in LINES.items():
        face = _face(coupling, INK)
        style: dict[str, Any] = {"color": INK, "linestyle": line, "marker": "o"}
        means = mean(coupling, sizes)
        axes.plot(sizes, means, markersize=2.2, markerfacecolor=face, **style)
        axes.annotate(
            COUPLING_NAMES[coupling],
            (sizes[-1], means[-1]),
            xytext=(0, 2.5),
            textcoords="offset points",
            ha="right",
            va="bottom",
            fontsize=SMALL,
        )
        near = [birds for birds in sizes if birds <= max(SHOWN)]
        inset.plot(near, mean(coupling, near), color=FAINT, linestyle=line, linewidth=0.7)
        for birds, (colour, symbol) in SHOWN.items():
            face = _face(coupling, colour)
            inset.plot(birds, mean(coupling, [birds]), symbol, color=colour, markerfacecolor=face)
    inset.set_xticks(list(SHOWN))
    inset.tick_params(labelsize=SMALL, pad=2)
    for panel in (axes, inset):
        panel.yaxis.set_major_locator(MaxNLocator(4, steps=(1, 2, 2.5, 5, 10)))
    axes.set_xlabel("number of birds $N$")


def _face(coupling: str, colour: str) -> str:
    return colour if coupling == "all" else "white"
