# SPDX-License-Identifier: Apache-2.0
"""`compare` reports its result, and refuses unreadable bags in one line."""

import json
import shutil
from dataclasses import replace
from math import inf, nan
from pathlib import Path

import numpy as np
import pytest

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.console.arguments import run_tool
from flock_sim.messages.types import State
from flock_sim.recording.run import Run
from flock_tools.commands.compare import tool
from flock_tools.runs.comparison import Comparison, compare
from support.flights import Change, record

CONFIGURATION = FlockConfiguration(
    birds=5, t_max=40.0, record_every=2, span_ratios=("2=1.0,1.02,0.97", "4=1.01")
)
STEPS = range(0, 41, 2)
MESSAGES = CONFIGURATION.birds * len(STEPS)


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("flight") / "run", CONFIGURATION)


def compared(first: Path, second: Path, tolerance: float | None = None) -> Comparison:
    with Run(first) as one, Run(second) as other:
        return compare(one, other, tolerance)


def at(bird: int, when: int, /, **changes: object) -> Change:
    """Changes one state; a function among `changes` makes the new value of the old one."""

    def change(who: int, state: State) -> State:
        if (who, state.step) != (bird, when):
            return state
        new = {
            name: value(getattr(state, name)) if callable(value) else value
            for name, value in changes.items()
        }
        return replace(state, **new)

    return change


def with_value(member: int, value: float):
    def change(values: np.ndarray) -> np.ndarray:
        changed = np.array(values)
        changed[member] = value
        return changed

    return change


@pytest.mark.parametrize(("value", "other"), [(nan, 1.0), (inf, 1.0), (inf, -inf), (nan, inf)])
def test_no_tolerance_bridges_what_is_not_finite(
    tmp_path: Path, value: float, other: float, capsys: pytest.CaptureFixture[str]
) -> None:
    one = record(tmp_path / "one", CONFIGURATION, at(1, 4, speed=with_value(0, value)))
    two = record(tmp_path / "two", CONFIGURATION, at(1, 4, speed=with_value(0, other)))
    assert compared(one, one, 1e300).equal
    assert not compared(one, two, 1e300).equal
    assert run_tool(tool, [str(one), str(two), "--json"]) == 1
    told = json.loads(capsys.readouterr().out, parse_constant=lambda name: pytest.fail(name))
    assert told["max_difference"]["speed"] is None
    assert told["first_difference"]["values"] == [
        number if np.isfinite(number) else str(number) for number in (value, other)
    ]


@pytest.mark.parametrize("shortened", [0, 1])
def test_a_flight_that_ends_earlier_is_not_equal_and_it_says_so(
    flight: Path, tmp_path: Path, shortened: int, capsys: pytest.CaptureFixture[str]
) -> None:
    record(tmp_path / "run", CONFIGURATION, lambda bird, state: state if state.step < 20 else None)
    runs = [str(flight), str(flight)]
    runs[shortened] = str(tmp_path / "run")
    assert run_tool(tool, [*runs, "--json"]) == 1
    told = json.loads(capsys.readouterr().out)
    assert told["messages"] == 5 * 10
    assert told["missing_messages"][shortened] == 5 * 11
    assert told["first_difference"]["kind"] == "missing"
    assert told["first_difference"]["step"] == 20
    assert told["first_difference"]["bird"] == 1
    assert run_tool(tool, runs) == 1
    assert "lacks 55 state messages, its last complete step is 18" in capsys.readouterr().out


def test_a_torn_bag_is_compared_as_far_as_it_is_whole(
    flight: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    torn = tmp_path / "torn"
    shutil.copytree(flight, torn)
    (torn / "metadata.yaml").unlink()
    assert run_tool(tool, [str(flight), str(torn)]) == 0
    told = capsys.readouterr()
    assert "equal bit for bit" in told.out
    assert "not complete" in told.err
    assert told.err.count("\n") == 1


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["RUN"], "RUN"),
        (["RUN", "RUN", "a third"], "a third"),
        (["RUN", "nowhere"], "nowhere"),
        (["empty", "RUN"], "empty"),
        (["foreign.mcap", "RUN"], "foreign.mcap"),
        (["RUN", "RUN", "--tolerance", "nan"], "--tolerance nan"),
        (["RUN", "RUN", "--tolerance", "-1e-9"], "--tolerance"),
        (["RUN", "RUN", "--tolerance=-1e-9"], "--tolerance -1e-9"),
        (["RUN", "RUN", "--tolerance", "inf"], "--tolerance inf"),
        (["RUN", "RUN", "--tolerance", "small"], "--tolerance small"),
    ],
)
def test_bad_input_is_one_line_and_status_2(
    flight: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    named: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("empty").mkdir()
    Path("foreign.mcap").write_bytes(b"no bag at all")
    arguments = [str(flight) if argument == "RUN" else argument for argument in arguments]
    assert run_tool(tool, [*arguments, "--json"]) == 2
    told = capsys.readouterr()
    assert told.out == ""
    assert told.err.count("\n") == 1
    assert named in told.err
