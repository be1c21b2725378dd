# SPDX-License-Identifier: Apache-2.0
"""The picture of a flock: the formation from above, and its history."""

from __future__ import annotations

from collections.abc import Sequence

import matplotlib as mpl
import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from flock_sim.analysis.metrics import STABLE_BELOW, Metrics
from flock_sim.analysis.time_means import TimeMeans
from flock_sim.analysis.verdict import Verdicts
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.physics.arrays import FloatArray
from flock_sim.recording.run import Run
from flock_tools.figures.labels import keep_apart
from flock_tools.figures.plan.drawing import draw_formation
from flock_tools.figures.plan.view import PlanView
from flock_tools.figures.style import ALARM, FAINT, INK, STYLE, flock_name
from flock_tools.runs.dataset import read

WIDTH = 9.0
"""Width of the picture, in inches; all lengths on it are in inches."""

LEFT, RIGHT = 0.85, 1.0
"""Room beside the formation: for the labels of its axis, and for the colour scale."""

LINE, ABOVE = 0.21, 0.36
"""Height of a line of the heading, and of the room between it and the formation."""

UNDER, TITLE = 0.55, 0.2
"""Room below a panel, for its axis, and above a curve, for its title."""

CURVES, BETWEEN = 2.2, 0.8
"""Height of the curves, and the room between them."""

SCALE, BESIDE = 0.14, 0.12
"""Width of the colour scale, and its distance from the formation."""

MOST_NAMED = 6
"""Largest number of spacings that are named."""

WIDEST_GAP, LINEAR = 30.0, 10.0
"""Spacing in b above which the axis of spacings is logarithmic, and its linear part."""

TIME = "time t (b/$U_\\mathrm{min}$)"


MOST_TIMES = 2000
"""Largest number of recorded rows that a curve is drawn through."""


def draw_run(run: Run, time: float | None, member: int) -> Figure:
    """Return the picture of `member` (from 1) of a run at `time`, in b / U_min; None is the end."""
    metrics, verdicts = run.metrics(time), run.verdicts(time)
    means = run.time_means(metrics.t_final)
    history = _history(run).sel(member=member)
    return draw(run.configuration, metrics, means, verdicts, history, member)


def _history(run: Run) -> xr.Dataset:
    """Return about MOST_TIMES rows of a run, with the first and the last."""
    end = run.at()
    rows = end.step // run.configuration.record_every + 1
    history = read(run, stride=-(-rows // MOST_TIMES))
    if history.step[-1] == end.step:
        return history
    return xr.concat([history, read(run, start=end.time)], "time", data_vars="minimal")


def draw(
    configuration: FlockConfiguration,
    metrics: Metrics,
    means: TimeMeans,
    verdicts: Verdicts,
    history: xr.Dataset,
    member: int,
) -> Figure:
    """Return the picture of `member` (from 1) at the moment of `metrics`.

    `history` is the history of the member from `dataset.load`, dims (time, bird). The heading gives
    the verdict on the member, if any.
    """
    view = PlanView.of(configuration, metrics, member - 1)
    heading = _heading(configuration, metrics, means, verdicts, member - 1)
    inch = (WIDTH - LEFT - RIGHT) / view.width
    above, main, below = (inch * part for part in (view.above, view.height, view.below))
    head = LINE * (heading.count("\n") + 1) + ABOVE
    height = head + above + main + below + UNDER + TITLE + CURVES + UNDER
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, height))

        def place(left: float, bottom: float, width: float, tall: float) -> Axes:
            return figure.add_axes((left / WIDTH, bottom / height, width / WIDTH, tall / height))

        corner = {"x": 0.12 / WIDTH, "y": 1.0 - 0.1 / height, "ha": "left", "va": "top"}
        figure.suptitle(heading, **corner, fontsize=10)
        bottom = UNDER + CURVES + TITLE + UNDER + below
        formation = place(LEFT, bottom, WIDTH - LEFT - RIGHT, main)
        scale = place(WIDTH - RIGHT + BESIDE, bottom + 0.05 * main, SCALE, 0.9 * main)
        labels = draw_formation(figure, formation, scale, view)
        whole = WIDTH - LEFT - RIGHT
        if configuration.birds == 1:
            curves = [_speed(place(LEFT, UNDER, whole, CURVES), history)]
        else:
            half = 0.5 * (whole - BETWEEN)
            spread = place(LEFT, UNDER, half, CURVES)
            spacings = place(LEFT + half + BETWEEN, UNDER, half, CURVES)
            curves = [_spread(spread, history), _spacings(spacings, history, metrics.leader)]
        for axes in curves:
            axes.set(xlabel=TIME, xlim=(0.0, max(float(history.time[-1]), configuration.dt)))
        if metrics.t_final < float(history.time[-1]):
            _mark_time(curves, metrics.t_final)
        keep_apart(figure, labels)
    return figure


def _mark_time(curves: Sequence[Axes], time: float) -> None:
    """Mark the time of the formation in the curves, and explain the mark above the first."""
    for axes in curves:
        axes.axvline(time, color=FAINT, linewidth=0.9, linestyle=":")
    curves[0].annotate(
        f"formation above: t = {time:g}",
        (time, 1.0),
        xytext=(0, 3),
        xycoords=("data", "axes fraction"),
        textcoords="offset points",
        ha="center",
        fontsize=7.5,
        color=FAINT,
    )


def _heading(
    configuration: FlockConfiguration,
    metrics: Metrics,
    means: TimeMeans,
    verdicts: Verdicts,
    m: int,
) -> str:
    facts = [told(verdicts, m)]
    if metrics.birds > 1:
        facts.append(f"$\\sigma_U$ = {metrics.speed_std[m]:.1e}")
    facts += [
        f"mean speed {metrics.mean_speed[m]:.4f} $U_\\mathrm{{min}}$",
        f"mean drag reduction {100 * metrics.mean_drag_reduction[m]:.1f} %",
    ]
    lines = [
        flock_name(configuration, m),
        f"t = {metrics.t_final:g}:  {',  '.join(facts)}",
    ]
    if means.recorded:
        lines += [
            f"mean over t = {means.averaged_from:g} to {means.until:g}:  speed "
            f"{means.time_mean_speed[m]:.4f} $U_\\mathrm{{min}}$,  drag reduction "
            f"{100 * means.time_mean_drag_reduction[m]:.1f} %"
        ]
    return "\n".join(lines)


def told(verdicts: Verdicts, m: int) -> str:
    """Return the verdict on the member with index `m`, with bird and time of a stall."""
    word, bird, time = verdicts.verdict[m], verdicts.stalled_bird[m], verdicts.stalled_at[m]
    return word if bird is None else f"{word}: bird {bird} at t = {time:g}"


def _speed(axes: Axes, history: xr.Dataset) -> Axes:
    """Draw the speed of a bird that flies alone."""
    axes.plot(history.time, history.speed, color=INK, linewidth=1.2)
    axes.set(ylabel="speed $U$ ($U_\\mathrm{min}$)")
    axes.ticklabel_format(axis="y", useOffset=False)
    return axes


def _spread(axes: Axes, history: xr.Dataset) -> Axes:
    """Draw sigma_U against time, and the threshold below which a flock is stable."""
    with np.errstate(invalid="ignore", over="ignore"):
        spread: FloatArray = history.speed.std("bird", skipna=False).to_numpy()
    # At the start all speeds are equal, so the spread is rounding error.
    shown = np.isfinite(spread) & (spread > 0.0) & (history.time.to_numpy() > 0.0)
    bottom = 0.5 * spread[shown].min(initial=STABLE_BELOW / 10.0)
    top = 2.0 * spread[shown].max(initial=STABLE_BELOW * 10.0)
    axes.set(
        yscale="log", ylim=(bottom, top), ylabel="spread of speeds $\\sigma_U$ ($U_\\mathrm{min}$)"
    )
    axes.axhspan(bottom, STABLE_BELOW, color="#e8f0ea", linewidth=0)
    axes.axhline(STABLE_BELOW, color=ALARM, linewidth=0.9)
    axes.plot(history.time, np.where(shown, spread, np.nan), color=INK, linewidth=1.1)
    axes.text(
        0.02,
        0.04,
        f"stable below {STABLE_BELOW:g}",
        transform=axes.transAxes,
        color=ALARM,
        fontsize=8,
    )
    return axes


def _spacings(axes: Axes, history: xr.Dataset, leader: int) -> Axes:
    """Draw the spacings along both wings against time, with a dashed right wing."""
    time = history.time.to_numpy()
    position = history.position.transpose("time", "bird").to_numpy()
    with np.errstate(invalid="ignore"):
        gap = np.diff(position, axis=1)
    gap[:, leader - 1 :] *= -1.0
    left = leader - 1
    shades = mpl.colormaps["plasma"](np.linspace(0.0, 0.82, max(left, 2)))
    for k in range(gap.shape[1]):
        from_tail = k if k < left else gap.shape[1] - 1 - k
        dashed = "-" if k < left else (0, (3, 3))
        named = k in _spread_out(left)
        axes.plot(
            time,
            gap[:, k],
            color=shades[from_tail],
            linewidth=1.0,
            linestyle=dashed,
            label=f"{k + 1} to {k + 2}" if named else None,
        )
    right = "; right wing dashed" if gap.shape[1] > left else ""
    axes.set(ylabel=f"spacing (b{right})")
    if np.abs(gap[np.isfinite(gap)]).max(initial=0.0) > WIDEST_GAP:
        _compress(axes)
    axes.legend(
        title="birds",
        loc="upper left",
        bbox_to_anchor=(1.0, 1.04),
        fontsize=7.5,
        title_fontsize=7.5,
        frameon=False,
        handlelength=1.2,
    )
    return axes


def _compress(axes: Axes) -> None:
    """Make the axis of spacings logarithmic beyond LINEAR, and say so."""
    axes.set_yscale("symlog", linthresh=LINEAR)
    axes.yaxis.set_major_formatter(lambda gap, _: f"{gap:g}".replace("-", "−"))
    bottom, top = axes.get_ylim()
    for ends in ((LINEAR, top), (bottom, -LINEAR)):
        if ends[0] < ends[1]:
            axes.axhspan(*ends, color="#eef1f3", linewidth=0, zorder=0)
    axes.set_ylim(bottom, top)
    axes.set_title(
        f"grey: logarithmic beyond {LINEAR:g} b", loc="left", fontsize=7.5, color=FAINT, pad=3.0
    )


def _spread_out(count: int) -> set[int]:
    """Return up to MOST_NAMED indices below `count`, which include the first and the last."""
    return {round(k) for k in np.linspace(0, count - 1, min(count, MOST_NAMED))}
