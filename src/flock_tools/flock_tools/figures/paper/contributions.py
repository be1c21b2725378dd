# SPDX-License-Identifier: Apache-2.0
"""Figure 2 of the paper: the contributions of near and far neighbours to the drag that is saved."""

from __future__ import annotations

from dataclasses import dataclass

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MultipleLocator, NullFormatter

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.physics.arrays import FloatArray
from flock_sim.physics.dynamics import drag_of_pair
from flock_sim.physics.flock import Flock
from flock_sim.theory.equilibrium import equilibrium
from flock_tools.figures.style import BLUE, COLUMN, GREEN, PRINT_STYLE, SMALL, VERMILLION
from flock_tools.figures.table import Table

CONFIGURATION = FlockConfiguration(birds=13, coupling="all")
STATE = "steady homogeneous all-to-all"

SHOWN = {1: (BLUE, "o", "-"), 4: (VERMILLION, "s", "--"), 7: (GREEN, "^", "-.")}
"""Birds that are shown, and the colour, symbol and line of each."""


@dataclass(frozen=True)
class Contributions:
    """The contributions of neighbours of order j to the drag of each bird, in a steady state."""

    drag: FloatArray
    """(D_{i+j,i} + D_{i-j,i}) / D_0, shape (birds, orders); nan if neither bird exists."""
    neighbours: FloatArray
    """Number of birds i + j and i - j that exist, shape (birds, orders)."""

    @property
    def normalized(self) -> FloatArray:
        """`drag` over its sum, shape (birds, orders)."""
        total: FloatArray = np.nansum(self.drag, axis=1, keepdims=True)
        return self.drag / total

    def table(self) -> Table:
        """Return the contributions to the birds that are shown, one row per order j."""
        rows: list[list[object]] = []
        for bird in SHOWN:
            for k in np.flatnonzero(self.neighbours[bird - 1]):
                values = (self.neighbours, self.normalized, self.drag)
                found, part, drag = (value[bird - 1, k] for value in values)
                rows.append([STATE, len(self.drag), bird, int(k) + 1, int(found), part, drag])
        columns = ("state", "birds", "bird", "order", "neighbours")
        return Table((*columns, "normalized_contribution", "interaction_drag_over_D0"), list(rows))


def contributions(configuration: FlockConfiguration = CONFIGURATION) -> Contributions:
    """Return the contributions in the steady state of the first member of `configuration`."""
    flock = Flock.of(configuration)
    state = equilibrium(flock)
    position, half_span = state.position[:, 0], flock.half_span[:, 0]
    circulation = flock.coefficients[:, 4, 0] / state.speed[0]
    drag = np.full((flock.birds, flock.birds - 1), np.nan)
    neighbours = np.zeros_like(drag)
    for k, (i, j) in enumerate(flock.pairs):
        exerted = drag_of_pair(
            position[j] - position[i],
            flock.lateral[k, 0],
            half_span[i],
            half_span[j],
            flock.even[k, 0],
            circulation[i],
            circulation[j],
        )
        order = j - i - 1
        for bird, by_other in zip((i, j), exerted, strict=True):
            drag[bird, order] = np.nansum([drag[bird, order], by_other / flock.scales.cruise_drag])
            neighbours[bird, order] += 1
    return Contributions(drag, neighbours)


def draw_contributions(data: Contributions) -> Figure:
    """Return figure 2. Its inset shows the same on logarithmic axes."""
    with mpl.rc_context(PRINT_STYLE):
        figure = Figure(figsize=(COLUMN, 2.4), layout="constrained")
        axes = figure.add_subplot()
        _curves(axes, data)
        orders = data.drag.shape[1]
        axes.set(
            xlabel="neighbour order $j$",
            ylabel="$(D_{i+j,i}+D_{i-j,i})\\,/\\,\\sum_{k\\neq i}D_{k,i}$",
            xlim=(0.5, orders + 0.5),
            ylim=(0.0, 0.9),
        )
        axes.xaxis.set_major_locator(MultipleLocator(1))
        axes.legend(loc="upper left", bbox_to_anchor=(0.1, 1.02))
        inset = axes.inset_axes((0.45, 0.36, 0.54, 0.62))
        _curves(inset, data)
        inset.set(xscale="log", yscale="log", xlim=(0.85, 1.2 * orders))
        inset.set_xticks([1, 2, 4, 8, 12], ["1", "2", "4", "8", "12"])
        inset.set_yticks([0.01, 0.1, 1.0], ["0.01", "0.1", "1"])
        inset.xaxis.set_minor_formatter(NullFormatter())
        inset.tick_params(labelsize=SMALL, pad=2)
    return figure


def _curves(axes: Axes, data: Contributions) -> None:
    order = np.arange(1, data.drag.shape[1] + 1)
    for bird, (colour, symbol, line) in SHOWN.items():
        axes.plot(
            order,
            data.normalized[bird - 1],
            color=colour,
            marker=symbol,
            linestyle=line,
            markerfacecolor="white",
            label=f"$i={bird}$",
        )
