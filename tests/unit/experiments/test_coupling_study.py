# SPDX-License-Identifier: Apache-2.0
"""The coupling study: flights agree with theory."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.console.arguments import run_tool
from flock_sim.theory.span_limits import exact_limits
from flock_tools.commands import study
from flock_tools.experiments import coupling_study
from flock_tools.experiments.coupling_study import BIRDS, MODIFIED, held, late_limits
from flock_tools.figures import files

STEP = 0.005


@pytest.fixture
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    """A study that ends soon."""
    ratios = tuple(round(0.94 + STEP * k, 3) for k in range(31))
    monkeypatch.setattr(coupling_study, "T_LIMITS", 2e4)
    monkeypatch.setattr(coupling_study, "T_STEADY", 2e4)
    monkeypatch.setattr(coupling_study, "SPAN_RATIOS", {"hold": ratios, "linear": ratios})
    monkeypatch.setattr(coupling_study, "DELAYS", (0, 1, 2))


def exact_ends() -> tuple[float, float]:
    (found,) = exact_limits(FlockConfiguration(birds=BIRDS), [MODIFIED], 0.5, 1.5)
    assert found.lower is not None
    assert found.upper is not None
    return found.lower.ratio, found.upper.ratio


def test_without_a_lag_limits_are_those_of_the_steady_state() -> None:
    assert late_limits(1e-9) == pytest.approx(exact_ends(), abs=3e-6)


@pytest.mark.usefixtures("short")
def test_geese_that_move_on_what_they_know_stay_together_between_the_exact_limits() -> None:
    kept = held("linear", "delay", 0).kept
    # Next to the limits a flock settles, or comes apart, more slowly than it is flown for.
    assert (min(kept), max(kept)) == pytest.approx(exact_ends(), abs=2 * STEP)


@pytest.mark.parametrize(
    ("together", "kept"),
    [
        ([True, True, True, True], (0.8, 0.9, 1.0, 1.1)),
        ([True, False, True, True], (1.0, 1.1)),
        ([True, True, True, False], (0.8, 0.9, 1.0)),
        ([True, False, True, False], (1.0,)),
        ([True, True, False, True], ()),
    ],
)
def test_what_stays_is_the_interval_around_one(together: list[bool], kept: tuple) -> None:
    words = ["holds" if one else "apart" for one in together]
    assert coupling_study._around_one((0.8, 0.9, 1.0, 1.1), words) == kept


def test_flocks_that_settle_between_those_that_hold_end_no_interval() -> None:
    words = ["settling", "holds", "settling", "holds", "settling", "apart"]
    ratios = (0.8, 0.85, 0.9, 1.0, 1.1, 1.2)
    assert coupling_study._around_one(ratios, words) == (0.85, 0.9, 1.0)


@pytest.mark.slow
@pytest.mark.usefixtures("short")
def test_the_study_writes_its_figure_and_its_data(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    faults = {"hold": {"drop": (0.1,)}, "linear": {"interval": (5,), "drop": (0.5,)}}
    monkeypatch.setattr(coupling_study, "FAULTS", faults)
    monkeypatch.setattr(coupling_study, "LAGS", np.array([0.1, 1.0]))
    monkeypatch.setattr(files, "RESOLUTION", 50)
    assert run_tool(study.tool, ["--output", str(tmp_path)]) == 0
    told = capsys.readouterr()
    names = ["coupling.png", "coupling.svg", "coupling_abc.csv", "coupling_def.csv"]
    assert told.out.splitlines() == [str(tmp_path / name) for name in names]
    with (tmp_path / "coupling_abc.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [(row["model"], row["delay_steps"]) for row in rows] == [
        (model, str(delay)) for model in ("hold", "linear") for delay in (0, 1, 2)
    ]
    for row in rows:
        off = abs(float(row["speed_U_min"]) - float(row["theory_speed_U_min"]))
        # Of second order in the step; linear links have no bias at all.
        assert off < (1e-2 if row["model"] == "hold" else 1e-7)
    with (tmp_path / "coupling_def.csv").open() as file:
        assert len(list(csv.DictReader(file))) == 3
