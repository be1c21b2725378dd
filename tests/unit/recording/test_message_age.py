# SPDX-License-Identifier: Apache-2.0
"""The ages and deviations of a free flight, for flights with known results."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.console.arguments import run_tool
from flock_sim.launcher.reference_flight import row
from flock_sim.messages.types import Ages
from flock_sim.recording.flight_writer import recording
from flock_sim.recording.message_age import deviation, freshness
from flock_sim.recording.own_parts import BIRD, LAW, LINK_MODEL, OwnPart, add_parts
from flock_sim.recording.run import Run
from flock_sim.reference.integrator import Reference
from flock_tools.commands import metrics
from support.flights import record
from support.tool_runs import text_of

FLOWN = FlockConfiguration(birds=3, t_max=100.0, record_every=1, span_ratios=("1=1,1.01",))
NEIGHBOURS = {1: 1, 2: 2, 3: 1}


def ages(bird: int, step: int) -> bytes:
    """Bird b knows all its neighbours b ms more than `step` ms late."""
    age = np.full(NEIGHBOURS[bird], 1e-3 * (step + bird))
    behind = np.full(NEIGHBOURS[bird], float(step % 2))
    return Ages(7, step, 1, bird, age, age + 0.5, behind, step // 10, 1e-3 * step).encode()


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    """A flight in which bird 2 was elsewhere at step 50, and faster at the end, in member 2."""
    return flown_freely(tmp_path / "bag")


def flown_freely(path: Path, *parts: OwnPart) -> Path:
    """Record the flight of `bag`; the bag names `parts`."""
    with recording(path, FLOWN, grants=True, factor=4.0) as run:
        add_parts(run.bag, parts)
        for recorded in Reference(FLOWN).fly():
            if recorded.step == 50:
                recorded.position[1, 1] += 0.5
            if recorded.step == 100:
                recorded.speed[1, 1] += 0.25
            told = [ages(bird, recorded.step) for bird in NEIGHBOURS]
            run.write_row(replace(row(FLOWN, recorded), ages=told))
    return path


def test_ages_are_told_in_seconds_and_in_the_flight_s_own_unit(bag: Path) -> None:
    with Run(bag) as run:
        fresh = freshness(run)
    assert fresh is not None
    link = fresh.links[2, 3]  # 3 ms to 103 ms
    assert (link.median, link.p95, link.max) == pytest.approx((0.053, 0.098, 0.603), rel=1e-12)
    # Four links, of birds 1, 2, 2 and 3: as if all were of bird 2, but for the ends.
    assert fresh.age is not None
    assert fresh.age.median == pytest.approx(0.052, rel=1e-12)
    told = fresh.as_json()
    assert told["age"]["max"] == pytest.approx(0.603 * 4.0 / FLOWN.second, rel=1e-12)
    assert told["steps_behind"] == {"median": 0.0, "p95": 1.0, "max": 1.0}
    assert (told["late_steps"], told["steps_taken"]) == ([10, 10, 10], 303)
    assert told["lateness_seconds"] == pytest.approx(0.1)


def test_the_deviation_is_that_from_the_lockstep_flight(bag: Path) -> None:
    with Run(bag) as run:
        off = deviation(run, lambda step: None).as_json()
    assert off["position"] == {"end": [0.0, 0.0], "max": [0.0, pytest.approx(0.5, rel=1e-12)]}
    assert off["spacing"] == {"end": [0.0, 0.0], "max": [0.0, pytest.approx(0.5, rel=1e-12)]}
    assert off["speed"]["end"] == off["speed"]["max"] == [0.0, pytest.approx(0.25, rel=1e-12)]


@pytest.mark.parametrize(
    "part",
    [
        OwnPart(BIRD, "Keeper"),
        OwnPart(LAW, "laws.py:keep", "sha256:0"),
        OwnPart(LINK_MODEL, "fading", every_stage=False),
    ],
)
def test_own_parts_have_no_deviation_because_their_flight_in_lockstep_is_not_known(
    part: OwnPart, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    flown = flown_freely(tmp_path / "bag", part)
    assert run_tool(metrics.tool, [str(flown), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["deviation"] is None
    assert told["own_parts"] == [str(part)]
    assert told["late_steps"] == [10, 10, 10]
    text = text_of(metrics.tool, capsys, str(flown))
    assert "at most 1; at recorded steps" in text
    assert "lockstep" not in text


def test_a_flight_in_lockstep_has_no_ages(tmp_path: Path) -> None:
    with Run(record(tmp_path / "bag", FLOWN)) as run:
        assert run.real_time_factor == 0.0
        assert freshness(run) is None
        assert list(run.ages()) == []
