# SPDX-License-Identifier: Apache-2.0
"""The verdict and the key numbers of a report, as text and as JSON."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from markupsafe import Markup

from flock_sim.analysis.metrics import STABLE_BELOW
from flock_sim.analysis.summary import hierarchy
from flock_sim.analysis.time_means import TimeMeans
from flock_sim.analysis.verdict import HOLDS
from flock_tools.report.data import Reported

MOST_ROWS = 500
"""Largest number of members, over all runs, whose key numbers are listed."""

ORDERED = {
    (True, True): "yes",
    (True, False): "left wing only",
    (False, True): "right wing only",
    (False, False): "no",
}
"""Texts for the wings, left and right, on which spacing falls to the leader."""

COLUMNS = tuple(
    Markup(name)
    for name in (
        "run",
        "verdict",
        "mean speed (U<sub>min</sub>)",
        "spread σ<sub>U</sub> (U<sub>min</sub>)",
        "drag saved (%)",
        "drag saved, mean over time (%)",
        "spacing falls to the leader",
        "deviation from the linear law",
        "deviation from the exact state (b)",
        "steady speed U* (U<sub>min</sub>)",
        "steady drag saved (%)",
        "leading eigenvalue (U<sub>min</sub>/b)",
        "at t (b/U<sub>min</sub>)",
    )
)


@dataclass(frozen=True)
class Verdict:
    """The verdict on a run, in one line."""

    name: str
    """Name of the run; empty if there is only one."""
    holds: bool
    words: str
    what: str
    """Description of the flock and of the flight time, and the reason of the verdict."""


@dataclass(frozen=True)
class Row:
    """The key numbers of a member."""

    run: int
    member: int | None
    """Index of the member; None if pictures do not show it."""
    name: str
    verdict: str
    holds: bool
    cells: list[str]


def verdict(run: Reported, named: bool) -> Verdict:
    """Return the verdict on `run`. `named` means that it is one of several."""
    verdicts, flown = run.verdicts, run.configuration
    several = len(verdicts.verdict) > 1
    words = f"members: {verdicts.counted()}" if several else verdicts.verdict[0]
    birds = f"{flown.birds} bird{'s' * (flown.birds > 1)}"
    reached = f"t = {run.metrics.t_final:g}"
    what = f"{birds}, {flown.coupling} coupling, at {reached}"
    if not several:
        what += f": {verdicts.verdict_reason[0]}"
    holds = all(word == HOLDS for word in verdicts.verdict)
    return Verdict(run.name if named else "", holds, words, what)


def rows(runs: Sequence[Reported]) -> list[Row]:
    """Return the key numbers of every member of every run, as text, in the order of COLUMNS."""
    places = [(r, m) for r, run in enumerate(runs) for m in range(run.metrics.members)]
    return [_row(r, runs[r], m) for r, m in places[:MOST_ROWS]]


def _over_time(means: TimeMeans, m: int) -> str:
    if not means.recorded:
        return "not recorded"
    saved = 100.0 * means.time_mean_drag_reduction[m]
    return f"{saved:.2f} (t = {means.averaged_from:g} to {means.until:g})"


def _row(r: int, run: Reported, m: int) -> Row:
    metrics, assessment = run.metrics, run.theory.assessment
    error = metrics.profile_error[m]
    ordered = ORDERED[metrics.falling_wings(m)] if metrics.leader > 2 else "-"
    off = _off(run, m)
    cells = [
        f"{metrics.mean_speed[m]:.9f}",
        f"{metrics.speed_std[m]:.3e}",
        f"{100.0 * metrics.mean_drag_reduction[m]:.2f}",
        _over_time(run.means, m),
        ordered,
        "-" if error is None else f"{error:.1e}",
        "-" if np.isnan(off) else f"{off:.1e}",
    ]
    if assessment is None or not assessment.state.exists[m]:
        cells += ["none" if assessment is not None else "not found", "-", "-"]
    else:
        cells += [
            f"{assessment.state.speed[m]:.9f}",
            f"{100.0 * assessment.state.drag_reduction[:, m].mean():.2f}",
            _eigenvalue(assessment.leading_eigenvalue[m]),
        ]
    name = run.name
    if metrics.members > 1:
        difference = differs(run, m)
        name = f"{name}, member {m + 1}" + (f": {difference}" if difference else "")
    shown = m if m < run.history.speed.shape[2] else None
    word = run.verdicts.verdict[m]
    return Row(r, shown, name, word, word == HOLDS, [*cells, f"{metrics.t_final:g}"])


def differs(run: Reported, m: int) -> str:
    """Return the spans in which a member differs from the others; empty if none."""
    ratio = run.configuration.span_ratio
    odd = np.flatnonzero(np.ptp(ratio, axis=1) > 0.0)
    return ", ".join(f"λ{bird + 1} = {ratio[bird, m]:g}" for bird in odd[:3])


def _off(run: Reported, m: int) -> float:
    """Return the largest error of the final spacings against exact ones, in b; nan for none."""
    assessment = run.theory.assessment
    if assessment is None or not assessment.state.exists[m] or run.metrics.birds == 1:
        return np.nan
    return float(np.abs(run.metrics.spacing[m] - assessment.state.spacing[:, m]).max())


def _eigenvalue(value: complex) -> str:
    if np.isnan(value):
        return "not computed"
    swing = f" ± {abs(value.imag):.4e} i" if value.imag else ""
    return f"{value.real:.4e}{swing}"


def cards(run: Reported) -> list[tuple[str, Markup, Markup | str]]:
    """Return the key numbers of a single member and run: name, value and explanation of each."""
    metrics, assessment = run.metrics, run.theory.assessment
    unit = Markup("{} <small>U<sub>min</sub></small>")
    speed = metrics.mean_speed[0] * run.configuration.min_drag_speed
    told: list[tuple[str, Markup, Markup | str]] = [
        ("mean speed U*", unit.format(f"{metrics.mean_speed[0]:.6f}"), f"{speed:.3f} m/s"),
        (
            "spread of speeds σ",
            unit.format(f"{metrics.speed_std[0]:.2e}"),
            f"stable by the paper's criterion below {STABLE_BELOW:g}",
        ),
        (
            "drag saved",
            Markup("{} <small>%</small>").format(f"{100.0 * metrics.mean_drag_reduction[0]:.2f}"),
            "mean of the birds, relative to D₀",
        ),
    ]
    if assessment is None or not assessment.state.exists[0]:
        state = "none exists" if assessment is not None else "not found"
        return [*told, ("exact steady state", Markup(state), "for these birds and this coupling")]
    leading = assessment.leading_eigenvalue[0]
    if metrics.birds > 1:
        order = hierarchy(metrics, 0) if metrics.leader > 2 else ""
        off = Markup("{} <small>b</small>").format(f"{_off(run, 0):.1e}")
        told.append(("deviation from the exact steady state", off, order))
    error = metrics.profile_error[0]
    if error is not None:
        told.append(("deviation from the linear law", Markup(f"{error:.1e}"), "of D/C = 1 − i/N"))
    if not np.isnan(leading):
        rate = Markup("{} <small>U<sub>min</sub>/b</small>").format(f"{leading.real:.2e}")
        firm = "stable" if assessment.stable[0] else "unstable"
        told.append(("leading eigenvalue", rate, f"real part; the steady state is {firm}"))
    return told


def key_numbers(run: Reported) -> dict[str, Any]:
    """Return the `--json` output of a run. Lists have one entry per member."""
    metrics, assessment = run.metrics, run.theory.assessment
    leading = [] if assessment is None else assessment.leading_eigenvalue
    return {
        "run": run.name,
        "missing": run.missing,
        "t_final": metrics.t_final,
        "members": metrics.members,
        "members_drawn": run.history.speed.shape[2],
        "stable": metrics.stable,
        **run.verdicts.as_json(),
        "mean_speed": metrics.mean_speed,
        "speed_std": metrics.speed_std,
        "mean_drag_reduction": metrics.mean_drag_reduction,
        "hierarchical": metrics.hierarchical,
        "profile_error": metrics.profile_error,
        "steady_speed": None if assessment is None else assessment.state.speed,
        "leading_eigenvalue": [[value.real, value.imag] for value in leading],
        "rows": run.history.rows,
        "state_digest": run.state_digest,
        "sha256": [digest for _, _, digest in run.files],
    }
