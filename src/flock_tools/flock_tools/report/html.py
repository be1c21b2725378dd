# SPDX-License-Identifier: Apache-2.0
"""The page of a report: one self-contained HTML file that makes no network requests.

Its charts are drawn by the scripts in `assets`, without a chart library. With Bokeh 3.9 inlined and
a line for each bird, a page opens three to four times as slowly for 13 birds (2.5 MB) and eight
times for 101 birds (10 MB), on the same machine, and its charts can't be read by keyboard. uPlot is
not a Python package, and has one list of times for all curves of a chart, while runs have different
ones.
"""

from __future__ import annotations

import base64
import hashlib
import platform
import re
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, FileSystemLoader
from markupsafe import Markup

from flock_sim import __version__
from flock_sim.analysis.metrics import STABLE_BELOW
from flock_sim.configuration import parameter_file
from flock_sim.configuration.flock_configuration import KEYS, FlockConfiguration
from flock_sim.configuration.options import FLOCK_OPTIONS
from flock_sim.physics.arrays import FloatArray
from flock_sim.recording.own_parts import BIRD, LINK_MODEL, OwnPart, lacking, names
from flock_tools.figures.bird_outline import OUTLINE
from flock_tools.report.data import Reported
from flock_tools.report.key_numbers import COLUMNS, MOST_ROWS, cards, differs, labels, rows, verdict

PAGE = Path(__file__).parent / "assets"

SCRIPTS = (
    "numbers.js",
    "chart.js",
    "reading.js",
    "curves.js",
    "theory.js",
    "formation.js",
    "report.js",
)
"""Scripts that draw the pictures, in the order of loading."""


def page(runs: Sequence[Reported]) -> bytes:
    """Return the HTML of a report on `runs` with equal numbers of birds.

    Equal runs give equal bytes. All content of bags is shown as text: the template escapes it, and
    the embedded data is JSON without `<`. By the page's own policy, only the script with the digest
    in it can run, and network requests are not possible.
    """
    script = "\n" + "\n".join((PAGE / name).read_text(encoding="utf-8") for name in SCRIPTS)
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    configuration = _configuration(runs)
    environment = Environment(loader=FileSystemLoader(PAGE), autoescape=True)
    text = environment.get_template("report.html").render(
        title=_listed([run.name for run in runs]),
        verdicts=[verdict(run, len(runs) > 1) for run in runs],
        units=_units(runs),
        cards=cards(runs[0]) if len(runs) == runs[0].metrics.members == 1 else [],
        warnings=[line for run in runs for line in (run.missing, _lacking(run)) if line],
        columns=COLUMNS,
        rows=rows(runs),
        remarks=_remarks(runs),
        names=[run.name for run in runs],
        labels=labels(runs),
        differences=[row for row in configuration if row[2]],
        configuration=configuration,
        files=[(run.name, parameter_file.text(run.configuration.parameters())) for run in runs],
        provenance=[{"name": run.name, "facts": _provenance(run)} for run in runs],
        decimation=" ".join(_decimation(run, len(runs) > 1) for run in runs),
        versions=f"Flock {__version__} with Python {platform.python_version()} "
        f"and NumPy {np.__version__}",
        style=Markup((PAGE / "report.css").read_text(encoding="utf-8")),
        script=Markup(script),
        script_hash=f"sha256-{digest}",
        data={
            "stable_below": STABLE_BELOW,
            "outline": OUTLINE.tolist(),
            "runs": [
                {"label": label, **_embedded(run)}
                for label, run in zip(labels(runs), runs, strict=True)
            ],
        },
    )
    # A path may hold bytes that are not valid text.
    return text.encode("utf-8", "backslashreplace")


def packed(values: FloatArray) -> dict[str, Any]:
    """Return an array with its members first, as `chart.js` reads it: base64 of 32-bit floats.

    `values` has shape (points, series, members) or (series, members). The result is transposed to
    [members, series, points] or [members, series].
    """
    turned = values.T
    with np.errstate(over="ignore"):
        numbers = np.ascontiguousarray(turned, dtype="<f4")
    return {
        "shape": list(turned.shape),
        "values": base64.b64encode(numbers.tobytes()).decode("ascii"),
    }


def _embedded(run: Reported) -> dict[str, Any]:
    """Return the data of a run for the script."""
    history, metrics = run.history, run.metrics
    members = history.speed.shape[2]
    flown = metrics.spacing[:members].T
    steady, eigen = np.full_like(flown, np.nan), np.zeros((0, members), dtype=complex)
    assessment = run.theory.assessment
    if assessment is not None:
        steady = assessment.state.spacing[:, :members]
        if assessment.eigenvalues is not None:
            eigen = assessment.eigenvalues[:members].T
    arrays = {
        "time": history.time,
        "speed": history.speed,
        "spacing": history.spacing,
        "drag_reduction": history.drag_reduction,
        "speed_std": history.speed_std,
        "mean_drag_reduction": history.mean_drag_reduction,
        "frame_time": history.frame_time,
        "frame_position": history.frame_position,
        "frame_speed": history.frame_speed,
        "frame_spacing": history.frame_spacing,
        "frame_drag_reduction": history.frame_drag_reduction,
        "frame_speed_std": history.frame_speed_std,
        "frame_mean_drag_reduction": history.frame_mean_drag_reduction,
        "lateral": metrics.lateral[:members].T,
        "span_ratio": run.configuration.span_ratio[:, :members],
        "final_spacing": flown,
        "steady_spacing": steady,
        "linear_spacing": run.theory.linear[:, :members],
        "off_exact": np.abs(flown - steady),
        "off_linear": np.abs(flown - run.theory.linear[:, :members]),
        "eigen_real": eigen.real,
        "eigen_imag": eigen.imag,
    }
    return {
        "name": run.name,
        "rows": history.rows,
        "width": history.width,
        "birds": metrics.birds,
        "leader": metrics.leader,
        "members": members,
        "member_names": [f": {differs(run, m)}" if differs(run, m) else "" for m in range(members)],
        "t_final": metrics.t_final,
        "no_theory": [_no_state(run, m) for m in range(members)],
        "no_eigenvalues": [_no_eigenvalues(run, m) for m in range(members)],
        **{name: packed(values) for name, values in arrays.items()},
    }


def _no_state(run: Reported, m: int) -> str:
    """Return why the steady state of a member is not known; empty if it is."""
    assessment = run.theory.assessment
    if assessment is None:
        return run.theory.note
    if not assessment.state.exists[m]:
        return "These birds have no steady state: the flock comes apart."
    return ""


def _no_eigenvalues(run: Reported, m: int) -> str:
    """Return why the eigenvalues of a member are not known; empty if they are."""
    assessment = run.theory.assessment
    if assessment is not None and assessment.eigenvalues is None:
        return f"The flock of {run.metrics.birds} birds is too large to compute them."
    return _no_state(run, m)


def _remarks(runs: Sequence[Reported]) -> list[str]:
    """Return the remarks on the key numbers."""
    remarks = [f"{run.name}: {run.theory.note}" for run in runs if run.theory.note]
    members = sum(run.metrics.members for run in runs)
    if members > MOST_ROWS:
        remarks.append(f"The first {MOST_ROWS} of {members} members are listed.")
    for run in runs:
        shown = run.history.speed.shape[2]
        if shown < run.metrics.members:
            remarks.append(
                f"{run.name}: pictures show the first {shown} of {run.metrics.members} members; "
                "more would make the file too large."
            )
    return remarks


def _listed(names: Sequence[str]) -> str:
    return " and ".join(part for part in (", ".join(names[:-1]), names[-1]) if part)


def _units(runs: Sequence[Reported]) -> dict[str, str]:
    """Return the units in SI if they are equal for all runs; otherwise empty."""
    each = [
        {
            "b": f"{0.5 * run.configuration.wing_span:g} m",
            "speed": f"{run.configuration.min_drag_speed:g} m/s",
            "time": f"{1e3 * run.configuration.second:.4g} ms",
        }
        for run in runs
    ]
    return each[0] if all(units == each[0] for units in each) else {}


def _configuration(runs: Sequence[Reported]) -> list[tuple[str, list[str], bool]]:
    """Return for each key: the key, the value of each run, and whether the values differ.

    Keys whose values differ come first.
    """
    parameters = [run.configuration.parameters() for run in runs]
    rows = {
        key: [_value(each[key], KEYS[key].unit) for each in parameters] for key in parameters[0]
    }
    rows["mode"] = [f"free, at factor {run.factor:g}" if run.factor else "lockstep" for run in runs]
    rows["own parts"] = [", ".join(map(_part, run.own_parts)) or "none" for run in runs]
    table = [(key, values, len(set(values)) > 1) for key, values in rows.items()]
    return sorted(table, key=lambda entry: not entry[2])


def _part(part: OwnPart) -> str:
    """Return an own part with its digest: laws of equal names may have different sources."""
    return f"{part} ({part.digest.removeprefix('sha256:')[:12]})" if part.digest else str(part)


def _value(value: object, unit: str) -> str:
    if isinstance(value, list):
        return "; ".join(value) or "none"
    text = str(value).removesuffix(".0")
    if unit == "1":
        return text
    marked = re.sub(r"\^(\w)", r"<sup>\1</sup>", re.sub(r"_(\w+)", r"<sub>\1</sub>", unit))
    return Markup("{} {}").format(text, Markup(marked))


def _lacking(run: Reported) -> str:
    """Return one line on the parts of a flight that its bag lacks; empty if it has all."""
    return f"{run.name} was {lacking(run.own_parts)}." if run.own_parts else ""


def _provenance(run: Reported) -> list[tuple[str, str]]:
    return [
        ("flown by", f"Flock {run.flock_version}"),
        ("own parts", ", ".join(map(str, run.own_parts)) or "none"),
        ("command", f"{command(run)} ({_flies(run)}; the original command is not recorded)"),
        ("repeat bit for bit", _repeat(run)),
        ("recorded on", "; then ".join(run.machines) or "not recorded"),
        ("digest of the states", run.state_digest or "not recorded"),
        *[("file", f"{file}, {size:,} bytes") for file, size, _ in run.files],
        *[("SHA-256", digest) for _, _, digest in run.files],
        ("perturbations in flight", "; ".join(run.pushes) or "none"),
        ("complete", run.missing or "yes"),
    ]


def _flies(run: Reported) -> str:
    """Return what the command of `run` flies, in words."""
    if names(run.own_parts, BIRD):
        return "flies the same flock with birds of Flock's, and not the same flight"
    if models := names(run.own_parts, LINK_MODEL):
        return f"needs the link model {models}, which is not in Flock"
    without = " without the perturbations in flight" if run.pushes else ""
    return f"flies the same flock{without}"


def _repeat(run: Reported) -> str:
    """Return how to repeat a flight bit for bit, or why this is not possible."""
    if birds := names(run.own_parts, BIRD):
        return f"not possible from the bag: birds of {birds} are not in Flock"
    again = f"./flock reference --repeat {shlex.quote(run.name)} --output again"
    if models := names(run.own_parts, LINK_MODEL):
        again = f"in a Python process that has registered the link model {models}: {again[8:]}"
    if run.factor:
        return f"a free flight can't be repeated; the same flock in lockstep: {again}"
    return again


def command(run: Reported) -> str:
    """Return the command that flies the flock of `run`, with options that are not defaults."""
    flown, usual = run.configuration.parameters(), FlockConfiguration().parameters()
    words = []
    for key, value in flown.items():
        if value != usual[key] and key in FLOCK_OPTIONS:
            each = value if isinstance(value, list) else [value]
            words += [word for entry in each for word in (FLOCK_OPTIONS[key], str(entry))]
    if any(flown[key] != usual[key] for key in flown.keys() - FLOCK_OPTIONS.keys()):
        words += ["--config", "flock.yaml"]  # the page has this file, too
    if run.factor:
        words += ["--mode", "free", "--real-time-factor", f"{run.factor:g}"]
    return shlex.join(["./flock", "fly", *words])


def _decimation(run: Reported, named: bool) -> str:
    """Return a description of the decimation of the bag's rows."""
    history = run.history
    curves = f"Curves show all {history.rows} recorded rows"
    if history.rows == 1:
        curves = "The bag has one row, the start, so curves are single points"
    if history.width > 1:
        curves = (
            f"Of the {history.rows} recorded rows, curves show the smallest and the largest value "
            f"of every {history.width}, in their order: no peak is lost, but its time is exact "
            "only to within these rows"
        )
    who = f"{run.name}: " if named else ""
    frames = len(history.frame_time)
    shown = f" The formation is shown at {frames} of them." if history.rows > 1 else ""
    return f"{who}{curves}.{shown}"
