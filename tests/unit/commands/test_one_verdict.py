# SPDX-License-Identifier: Apache-2.0
"""Metrics and report give one flight the same word."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from flock_sim.analysis.verdict import APART, HOLDS, SETTLING, STALLED
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.console.arguments import run_tool
from flock_sim.recording.run import Run
from flock_tools.commands import metrics, report
from support.flights import record

FLIGHTS = {
    HOLDS: {"birds": 3, "t_max": 2e4},
    SETTLING: {"birds": 3, "t_max": 500.0},
    APART: {"birds": 3, "t_max": 2e4, "span_ratios": ("1=0.8",)},
    STALLED: {"birds": 3, "t_max": 3000.0, "perturbations": ("1@500=0,-0.72",)},
}


@pytest.mark.parametrize("word", FLIGHTS)
def test_every_tool_gives_a_flight_the_same_word(
    word: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = record(tmp_path / "run", FlockConfiguration(record_every=50, **FLIGHTS[word]))
    with Run(bag) as run:
        assert run.verdicts().verdict == [word]
    assert run_tool(metrics.tool, [str(bag), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["verdict"] == [word]
    assert run_tool(metrics.tool, [str(bag)]) == 0
    assert f"verdict              {word}: " in capsys.readouterr().out
    assert run_tool(report.tool, [str(bag), "--output", str(tmp_path / "page.html")]) == 0
    assert f"</span> {word}</strong>" in (tmp_path / "page.html").read_text(encoding="utf-8")
