# SPDX-License-Identifier: Apache-2.0
"""The metrics of a run as text."""

from __future__ import annotations

import numpy as np

from flock_sim.analysis.metrics import STABLE_BELOW, Metrics
from flock_sim.analysis.time_means import TimeMeans
from flock_sim.analysis.verdict import Verdicts
from flock_sim.physics.arrays import FloatArray

MOST_MEMBERS = 12
WIDTH = 8
"""Number of values per line."""


def summary(metrics: Metrics, means: TimeMeans, verdicts: Verdicts) -> str:
    """Return the lines that `fly`, `reference` and `metrics` print."""
    flock = f"{metrics.birds} bird{'s' * (metrics.birds > 1)}, {metrics.coupling} coupling"
    if metrics.members > 1:
        flock += f", {metrics.members} members"
    steps = f"{metrics.steps} step{'s' * (metrics.steps != 1)} of {metrics.dt:g}"
    lines = [f"{flock}, t = {metrics.t_final:g} ({steps})"]
    shown = min(metrics.members, MOST_MEMBERS)
    for m in range(shown):
        lines += ["", f"member {m + 1}"] if metrics.members > 1 else []
        lines += _member(metrics, means, verdicts, m)
    if shown < metrics.members:
        lines += ["", f"... and {metrics.members - shown} members more"]
    if metrics.members > 1:
        stable = f"{sum(metrics.stable)} with sigma_U < {STABLE_BELOW:g}"
        lines += ["", f"{metrics.members} members: {verdicts.counted()}; {stable}"]
    return "\n".join(lines)


def _member(metrics: Metrics, means: TimeMeans, verdicts: Verdicts, m: int) -> list[str]:
    paper = f"{'' if metrics.stable[m] else 'not '}stable by the paper's criterion"
    lines = [
        f"  verdict              {verdicts.verdict[m]}: {verdicts.verdict_reason[m]}",
        f"  mean speed U*        {metrics.mean_speed[m]:.9f} U_min",
        f"  spread sigma_U       {metrics.speed_std[m]:.3e} U_min ({paper}, < {STABLE_BELOW:g})",
        f"  mean drag reduction  {100 * metrics.mean_drag_reduction[m]:.2f} %",
        f"  mean over time       {_over_time(means, m)}",
    ]
    if metrics.birds > 1:
        lines += wings(metrics.spacing[m], metrics.drag_reduction[m], metrics.leader)
    if metrics.leader > 2:
        lines += [f"  hierarchy            {hierarchy(metrics, m)}"]
    error = metrics.profile_error[m]
    if error is not None:
        lines += [f"  linear law           D/C = 1 - (i-1)/N to {error:.1e}"]
    return lines


def _over_time(means: TimeMeans, m: int) -> str:
    if not means.recorded:
        return "not in this bag, whose states have no means"
    return (
        f"{100 * means.time_mean_drag_reduction[m]:.2f} % of drag saved, speed "
        f"{means.time_mean_speed[m]:.6f} U_min (t = {means.averaged_from:g} to {means.until:g})"
    )


def hierarchy(metrics: Metrics, m: int) -> str:
    """Return in words on which wings spacing falls from tail to leader."""
    left, right = metrics.falling_wings(m)
    if left == right:
        return f"spacing {'falls' if left else 'does not fall'} from tail to leader"
    return f"spacing falls from tail to leader on the {'left' if left else 'right'} wing only"


def wings(spacing: FloatArray, drag_reduction: FloatArray, leader: int) -> list[str]:
    """Return spacing and saved drag along the left wing, and along the right one if it differs.

    `spacing` has shape (birds - 1,), in b, `drag_reduction` (birds,), for two birds or more.
    """
    head = leader - 1
    saved = 100.0 * drag_reduction
    left, right = spacing[:head], -spacing[head:][::-1]
    left_saved, right_saved = saved[: head + 1], saved[head:][::-1]
    if len(right) == 0:
        return [*row("spacing", left, 4), *row("drag saved, %", left_saved, 1)]
    if _alike(left, right, 5e-4) and _alike(left_saved, right_saved, 0.05):
        return [
            *row("spacing, left wing", left, 4),
            *row("drag saved, %", left_saved, 1),
        ]
    return [
        *row("spacing, left wing", left, 4),
        *row("spacing, right wing", right, 4),
        *row("drag saved, %, left", left_saved, 1),
        *row("drag saved, %, right", right_saved, 1),
    ]


def _alike(left: FloatArray, right: FloatArray, tolerance: float) -> bool:
    return len(left) == len(right) and np.allclose(left, right, rtol=0.0, atol=tolerance)


def row(name: str, values: FloatArray, digits: int, order: str = "(tail to leader)") -> list[str]:
    """Return the values in as many lines as needed; `order` is a note on their order."""
    # Adding 0.0 to a rounded value turns -0.0 into 0.0.
    cells = [f"{round(float(value), digits) + 0.0:8.{digits}f}" for value in values]
    rows = [cells[k : k + WIDTH] for k in range(0, len(cells), WIDTH)]
    lines = [f"  {'':<20} {' '.join(line)}" for line in rows]
    lines[0] = f"  {name:<20} {' '.join(rows[0])}   {order}"
    return lines
