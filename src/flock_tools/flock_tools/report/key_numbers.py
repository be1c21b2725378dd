# SPDX-License-Identifier: Apache-2.0
"""The verdict and the key numbers of a report, as text and as JSON."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
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

SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")

COLUMNS = tuple(
    Markup(name)
    for name in (
        "run",
        "verdict",
        "mean speed (U<sub>min</sub>)",
        "spread σ<sub>U</sub> (U<sub>min</sub>)",
        "drag saved (%)",
        "drag saved, mean from t to the end (%)",
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


def labels(runs: Sequence[Reported]) -> list[str]:
    """Return short names of the runs: without their directory if that is the same for all."""
    names = [run.name for run in runs]
    parents = {str(Path(name).parent) for name in names}
    if len(parents) == 1:
        names = [Path(name).name or name for name in names]
    seen = [names[: k + 1].count(name) for k, name in enumerate(names)]
    return [f"{name} ({k})" if names.count(name) > 1 else name for name, k in zip(names, seen)]


def rows(runs: Sequence[Reported]) -> list[Row]:
    """Return the key numbers of every member of every run, as text, in the order of COLUMNS."""
    places = [(r, m) for r, run in enumerate(runs) for m in range(run.metrics.members)]
    short = labels(runs)
    return [_row(r, runs[r], m, short[r]) for r, m in places[:MOST_ROWS]]


def power(value: float, digits: int) -> str:
    """Return a number with `digits` decimals and a power of ten, as 1.2 × 10⁻⁵.

    Numbers that are easily read without a power of ten have none.
    """
    if not np.isfinite(value):
        return "not finite"
    if value == 0.0:
        return "0"
    if 0.01 <= abs(value) < 1000.0:
        return fixed(value, max(0, digits - math.floor(math.log10(abs(value)))))
    factor, exponent = f"{value:.{digits}e}".split("e")
    times = (
        "" if factor == "1" else f"{factor}\N{NO-BREAK SPACE}×\N{NO-BREAK SPACE}".replace("-", "−")
    )
    return f"{times}10{str(int(exponent)).translate(SUPERSCRIPTS)}"


def fixed(value: float, decimals: int) -> str:
    """Return a number with `decimals` decimals, or with a power of ten if it is large."""
    if np.isfinite(value) and abs(value) < 1e6:
        return f"{value:.{decimals}f}".replace("-", "−")
    return power(value, 2)


def _over_time(means: TimeMeans, m: int) -> str:
    if not means.recorded:
        return "not recorded"
    saved = 100.0 * means.time_mean_drag_reduction[m]
    return f"{fixed(saved, 2)} (t = {means.averaged_from:g})".replace(
        " = ", "\N{NO-BREAK SPACE}=\N{NO-BREAK SPACE}"
    )


def _row(r: int, run: Reported, m: int, name: str) -> Row:
    metrics, assessment = run.metrics, run.theory.assessment
    error = metrics.profile_error[m]
    ordered = ORDERED[metrics.falling_wings(m)] if metrics.leader > 2 else "-"
    off = _off(run, m)
    cells = [
        fixed(metrics.mean_speed[m], 7),
        power(metrics.speed_std[m], 2),
        fixed(100.0 * metrics.mean_drag_reduction[m], 2),
        _over_time(run.means, m),
        ordered,
        "-" if error is None else power(error, 1),
        "-" if np.isnan(off) else power(off, 1),
    ]
    if assessment is None or not assessment.state.exists[m]:
        cells += ["none" if assessment is not None else "not found", "-", "-"]
    else:
        cells += [
            fixed(assessment.state.speed[m], 7),
            fixed(100.0 * assessment.state.drag_reduction[:, m].mean(), 2),
            _eigenvalue(assessment.leading_eigenvalue[m]),
        ]
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
    swing = f" ± {power(abs(value.imag), 2)} i" if value.imag else ""
    return f"{power(value.real, 2)}{swing}"


def cards(run: Reported) -> list[tuple[str, Markup, Markup | str]]:
    """Return the key numbers of a single member and run: name, value and explanation of each."""
    metrics, assessment = run.metrics, run.theory.assessment
    unit = Markup("{} <small>U<sub>min</sub></small>")
    speed = metrics.mean_speed[0] * run.configuration.min_drag_speed
    told: list[tuple[str, Markup, Markup | str]] = [
        ("mean speed U*", unit.format(fixed(metrics.mean_speed[0], 6)), f"{fixed(speed, 3)} m/s"),
        (
            "spread of speeds σ",
            unit.format(power(metrics.speed_std[0], 2)),
            f"stable by the paper's criterion below {power(STABLE_BELOW, 0)}",
        ),
        (
            "drag saved",
            Markup("{} <small>%</small>").format(fixed(100.0 * metrics.mean_drag_reduction[0], 2)),
            "mean of the birds, relative to D₀",
        ),
    ]
    if assessment is None or not assessment.state.exists[0]:
        state = "none exists" if assessment is not None else "not found"
        return [*told, ("exact steady state", Markup(state), "for these birds and this coupling")]
    leading = assessment.leading_eigenvalue[0]
    if metrics.birds > 1:
        order = hierarchy(metrics, 0) if metrics.leader > 2 else ""
        off = Markup("{} <small>b</small>").format(power(_off(run, 0), 1))
        told.append(("deviation from the exact steady state", off, order))
    error = metrics.profile_error[0]
    if error is not None:
        told.append(("deviation from the linear law", Markup(power(error, 1)), "of D/C = 1 − i/N"))
    if not np.isnan(leading):
        rate = Markup("{} <small>U<sub>min</sub>/b</small>").format(power(leading.real, 2))
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
