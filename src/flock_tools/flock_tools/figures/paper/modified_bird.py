# SPDX-License-Identifier: Apache-2.0
"""Figure 5 of the paper: steady states of a flock with one bird of another span."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import MultipleLocator

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.physics.flock import Flock
from flock_sim.theory.equilibrium import Equilibrium, equilibrium
from flock_sim.theory.span_limits import modified_span_ratios
from flock_tools.figures.style import BLUE, INK, PAGE, PRINT_STYLE, VERMILLION
from flock_tools.figures.table import Table

BIRDS = 13
LEADER = 7

CASES = {1: (0.995, 1.0, 1.03), 4: (0.98, 1.0, 1.03), 7: (0.95, 1.0, 1.03)}
"""Modified birds, and for each lambda below 1, 1 and above 1, well within its limits."""

LOOKS: tuple[dict[str, Any], ...] = (
    {"color": BLUE, "marker": "v", "linestyle": (0, (3.5, 1.8))},
    {"color": INK, "marker": "o", "linestyle": "-"},
    {"color": VERMILLION, "marker": "^", "linestyle": "-."},
)
"""Styles for lambda below 1, 1 and above 1."""


def modified_flocks() -> dict[int, Equilibrium]:
    """Return the steady states for each modified bird. Their members are the values of lambda."""
    flock = FlockConfiguration(birds=BIRDS)
    return {
        bird: equilibrium(
            Flock.of(flock, modified_span_ratios(flock, [bird] * len(ratios), ratios))
        )
        for bird, ratios in CASES.items()
    }


def modified_table(data: dict[int, Equilibrium]) -> Table:
    """Return the data of all panels, one bird of a flock per row."""
    rows: list[Sequence[object]] = []
    for modified, state in data.items():
        along, across = 0.5 * state.position, 0.5 * state.lateral
        for m, ratio in enumerate(CASES[modified]):
            for i in range(BIRDS):
                place, saved = (along[i, m], across[i, m]), state.drag_reduction[i, m]
                rows.append([modified, ratio, i + 1, *place, saved, state.speed[m]])
    columns = ("modified_bird", "span_ratio", "bird", "x_over_2b", "y_over_2b")
    return Table((*columns, "drag_reduction", "speed_over_Umin"), rows)


def draw_modified(data: dict[int, Equilibrium]) -> Figure:
    """Return figure 5."""
    with mpl.rc_context(PRINT_STYLE):
        figure = Figure(figsize=(PAGE, 4.2), layout="constrained")
        panels = figure.subplots(2, len(data), sharex="row", sharey="row")
        for column, (modified, state) in enumerate(data.items()):
            upper, lower = panels[:, column]
            for m, (ratio, look) in enumerate(zip(CASES[modified], LOOKS)):
                style = {**look, "markerfacecolor": "white"}
                name = f"$\\lambda_{{{modified}}}={ratio:g}$"
                upper.plot(state.lateral[:, m], state.position[:, m], label=name, **style)
                saved = 100.0 * state.drag_reduction[:, m]
                lower.plot(np.arange(1, BIRDS + 1), saved, label=name, **style)
            upper.set(title=f"({'abc'[column]})", xlabel="lateral position $y_i$ (b)")
            lower.set(title=f"({'def'[column]})", xlabel="bird $i$")
            if modified != LEADER:
                _frame(upper, state, modified)
            upper.legend(loc="best")
        panels[0, 0].set_ylabel("streamwise position $x_i$ (b)")
        panels[1, 0].set_ylabel("drag reduction $\\eta_i$ (%)")
        panels[1, 0].xaxis.set_major_locator(MultipleLocator(2, offset=1))
    return figure


def _frame(axes: Axes, state: Equilibrium, bird: int) -> None:
    """Draw a dashed box round all positions of the modified bird."""
    across, along = state.lateral[bird - 1], state.position[bird - 1]
    left, right = across.min() - 0.8, across.max() + 0.8
    bottom, top = along.min() - 0.6, along.max() + 0.6
    axes.add_patch(
        Rectangle(
            (left, bottom),
            right - left,
            top - bottom,
            fill=False,
            edgecolor="black",
            linewidth=0.8,
            linestyle=(0, (3, 2)),
            zorder=3,
        )
    )
