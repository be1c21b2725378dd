# SPDX-License-Identifier: Apache-2.0
"""The figure of the coupling study."""

from __future__ import annotations

from collections.abc import Sequence

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from flock_sim.theory.delayed.linearisation import HOLD, LINEAR
from flock_tools.experiments.coupling_study import (
    BIRDS,
    LAGS,
    MODIFIED,
    SPAN_RATIOS,
    Delayed,
    Held,
    late_limits,
)
from flock_tools.figures.style import BLUE, FAINT, GREEN, PAGE, PRINT_STYLE, SMALL, VERMILLION
from flock_tools.figures.table import Table

COLOURS = {HOLD: VERMILLION, LINEAR: BLUE}
MARKERS = {HOLD: "s", LINEAR: "o"}
LINES = {HOLD: "-", LINEAR: "--"}

LAG = "age of neighbour data (b/$U_{min}$)"


def draw_study(delayed: Sequence[Delayed], limits: Sequence[Held], critical: float) -> Figure:
    """Return the figure; `critical` is the lag at which `linear` loses stability, in b / U_min."""
    with mpl.rc_context(PRINT_STYLE):
        figure = Figure(figsize=(PAGE, 4.9), layout="constrained")
        top, bottom = figure.subplots(2, 3)
        _steady(top[0], delayed, "speed", "speed $U^*$ ($U_{min}$)")
        _steady(top[1], delayed, "gap", "gap from tail to leader (b)")
        _settling(top[2], delayed)
        for axes in top:
            line = axes.axvline(critical, color=FAINT, linewidth=0.8, linestyle=":", zorder=0)
            axes.set_xlabel(LAG)
        top[0].set_title("(a) three geese")
        top[1].set_title("(b) three geese")
        top[2].set_title("(c) three geese")
        _held_late(bottom[0], [found for found in limits if found.model == HOLD])
        moved = [found for found in limits if found.model == LINEAR]
        _moved_late(bottom[1], moved)
        _moved_lossy(bottom[2], [found for found in moved if found.key == "drop"])
        bottom[0].set_title(f"(d) {BIRDS} geese, hold")
        bottom[1].set_title(f"(e) {BIRDS} geese, linear")
        bottom[2].set_title(f"(f) {BIRDS} geese, linear")
        for axes in bottom:
            axes.set_ylabel(f"stable span ratio $\\lambda_{MODIFIED}$")
        for axes in (*top, *bottom):
            axes.grid(visible=True)
            axes.legend(loc="best", fontsize=SMALL)
        told = "(a) to (c): lag at which `linear` loses stability"
        figure.legend([line], [told], loc="outside lower left")
    return figure


def _steady(axes: Axes, delayed: Sequence[Delayed], what: str, label: str) -> None:
    """Draw a quantity of the steady state against lag: flown, and by theory."""
    for model, colour in COLOURS.items():
        flights = [flight for flight in delayed if flight.model == model]
        lag = [flight.lag for flight in flights]
        theory = [getattr(flight, f"theory_{what}") for flight in flights]
        axes.plot(lag, theory, LINES[model], color=colour, label=f"{model}, theory")
        axes.errorbar(
            lag,
            [getattr(flight, what) for flight in flights],
            yerr=[0.5 * flight.swing for flight in flights] if what == "gap" else None,
            fmt=MARKERS[model],
            color=colour,
            markerfacecolor="white",
            elinewidth=0.8,
            label=f"{model}, flown",
        )
    axes.set_ylabel(label)


def _settling(axes: Axes, delayed: Sequence[Delayed]) -> None:
    for model, colour in COLOURS.items():
        flights = [f for f in delayed if f.model == model and np.isfinite(f.settled)]
        axes.plot(
            [flight.lag for flight in flights],
            [flight.settled for flight in flights],
            MARKERS[model],
            color=colour,
            markerfacecolor="white",
            label=model,
        )
    axes.set(ylabel="time to settle (b/$U_{min}$),\nlogarithmic", yscale="log")


def _held_late(axes: Axes, limits: Sequence[Held]) -> None:
    ends = np.array([late_limits(float(lag)) for lag in LAGS]).T
    axes.fill_between(LAGS, *ends, color=VERMILLION, alpha=0.15, linewidth=0)
    axes.plot(LAGS, ends[0], color=VERMILLION, label="theory")
    axes.plot(LAGS, ends[1], color=VERMILLION)
    _ends(axes, [f for f in limits if f.key == "interval"], "s", VERMILLION, "interval")
    _ends(axes, [f for f in limits if f.key == "drop"], "D", GREEN, "loss")
    axes.set(xlabel=f"{LAG},\nlogarithmic", xscale="log")
    axes.xaxis.set_major_formatter("{x:g}")


def _moved_late(axes: Axes, limits: Sequence[Held]) -> None:
    for key, marker, colour in (("delay", "o", BLUE), ("interval", "^", GREEN)):
        _ends(axes, [f for f in limits if f.key == key], marker, colour, key)
    axes.set(xlabel=LAG, ylim=(SPAN_RATIOS[LINEAR][0], SPAN_RATIOS[LINEAR][-1]))


def _moved_lossy(axes: Axes, limits: Sequence[Held]) -> None:
    arrives = [1.0 - found.value for found in limits]
    for end in (min, max):
        axes.plot(
            arrives,
            [end(found.kept) if found.kept else np.nan for found in limits],
            "D-",
            color=GREEN,
            markerfacecolor="white",
            label="loss" if end is min else None,
        )
    axes.set(
        xlabel="fraction of messages that arrive,\nlogarithmic",
        xscale="log",
        ylim=(SPAN_RATIOS[LINEAR][0], SPAN_RATIOS[LINEAR][-1]),
    )
    axes.invert_xaxis()
    axes.xaxis.set_major_formatter("{x:g}")


def _ends(axes: Axes, limits: Sequence[Held], marker: str, colour: str, label: str) -> None:
    """Draw both ends of intervals against the age of received states."""
    kept = [found for found in limits if found.kept]
    for end in (min, max):
        axes.plot(
            [found.age for found in kept],
            [end(found.kept) for found in kept],
            marker,
            color=colour,
            markerfacecolor="white",
            label=label if end is min else None,
        )


def delayed_table(flights: Sequence[Delayed]) -> Table:
    """Return the flights, one per row."""
    columns = (
        "model",
        "delay_steps",
        "lag_b_per_U_min",
        "speed_U_min",
        "tail_gap_b",
        "swing_of_gap_b",
        "settling_time_b_per_U_min",
        "theory_speed_U_min",
        "theory_gap_b",
    )
    return Table(columns, [tuple(vars(flight).values()) for flight in flights])


def held_table(limits: Sequence[Held]) -> Table:
    """Return the limits, one link setting per row."""
    rows: list[Sequence[object]] = [
        (
            found.model,
            found.key,
            found.value,
            min(found.kept, default=None),
            max(found.kept, default=None),
        )
        for found in limits
    ]
    return Table(("model", "key", "value", "lower_span_ratio", "upper_span_ratio"), rows)
