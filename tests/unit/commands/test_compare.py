# SPDX-License-Identifier: Apache-2.0
"""`compare` reports its result, and refuses unreadable bags in one line."""

import json
import shutil
from dataclasses import asdict, replace
from functools import partial
from math import inf, nan
from pathlib import Path

import numpy as np
import pytest

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.console.arguments import run_tool
from flock_sim.messages.types import State
from flock_sim.recording import flight_writer
from flock_sim.recording.flight_writer import recording
from flock_sim.recording.machine import Machine, this_machine
from flock_sim.recording.run import Run
from flock_tools.commands import repair
from flock_tools.commands.compare import tool
from flock_tools.runs import comparison
from flock_tools.runs.comparison import Comparison, compare
from flock_tools.runs.pairing import MOST_WAITING, pairs
from support.flights import Change, flown_rows, record

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


def test_states_are_compared_at_equal_times_whatever_the_time_step(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    flown = FlockConfiguration(birds=3, t_max=40.0, dt=0.25, record_every=4)
    fine = record(tmp_path / "fine", flown)
    coarse = record(tmp_path / "coarse", replace(flown, dt=0.5, record_every=2))
    sparse = record(tmp_path / "sparse", replace(flown, dt=0.5, record_every=4))
    result = compared(fine, coarse)
    assert result.messages == 3 * 41
    assert result.missing == [0, 0]
    with Run(fine) as one, Run(coarse) as other:
        pairs = list(zip(one.snapshots(), other.snapshots(), strict=True))
    for name, gap in result.max_difference.items():
        far = max(np.abs(getattr(a, name) - getattr(b, name)).max() for a, b in pairs)
        assert gap == far < 1e-9
    assert run_tool(tool, [str(fine), str(sparse)]) == 1
    told = capsys.readouterr().out
    assert "the first difference is at step 4 (t = 1), bird 1: only the first run" in told
    assert f"{sparse} lacks 60 state messages" in told


def test_flocks_of_other_members_have_no_values_to_compare(
    flight: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    alone = record(tmp_path / "alone", replace(CONFIGURATION, span_ratios=()))
    assert run_tool(tool, [str(alone), str(flight)]) == 1
    told = capsys.readouterr().out
    assert "position of 1 and 3 members" in told
    assert "no values are compared: the runs have 1 and 3 members" in told
    assert "largest differences" not in told
    assert set(compared(alone, flight).as_json()["max_difference"].values()) == {None}


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


def with_machine(directory: Path, *machines: Machine) -> Path:
    with recording(directory, CONFIGURATION, grants=False, machines=machines) as run:
        for row in flown_rows(CONFIGURATION):
            run.write_row(row)
    return directory


def from_before(directory: Path) -> Path:
    """Record a bag as it was before bags had digests and machines."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(flight_writer, "result_record", lambda digest: {})
        return with_machine(directory)


def test_the_digests_and_machines_are_told(
    flight: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    here = this_machine()
    there = replace(here, processor="another", c_library="musl 1.2", numpy="1.0", rmw="rmw_x")
    two = with_machine(tmp_path / "two", here, there)
    assert run_tool(tool, [str(flight), str(two), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    with Run(flight) as run:
        assert told["digests"] == 2 * [run.state_digest]
        assert told["digests"][0].startswith("sha256:")
    assert told["machines"] == [[asdict(here)], [asdict(here), asdict(there)]]

    assert run_tool(tool, [str(flight), str(two)]) == 0
    first, second = capsys.readouterr().out.splitlines()[1:]
    facts = f"{here.processor}, {here.c_library}, NumPy {here.numpy}"
    assert first == f"  {flight}: {told['digests'][0]}, recorded on {facts}"
    assert second == (
        f"  {two}: {told['digests'][0]}, recorded on {facts}; another, musl 1.2, NumPy 1.0"
    )


def test_a_bag_without_digest_and_machine_is_compared_as_before(
    flight: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    old = from_before(tmp_path / "old")
    assert run_tool(tool, [str(old), str(flight), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["digests"][0] is told["machines"][0] is None
    assert told["digests"][1] is not None
    assert run_tool(tool, [str(old), str(flight)]) == 0
    line = capsys.readouterr().out.splitlines()[1]
    assert line == f"  {old}: no digest of its states, recorded on an unknown machine"


def test_other_values_have_another_digest(
    flight: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = record(tmp_path / "other", CONFIGURATION, at(3, 20, speed=with_value(1, nan)))
    assert run_tool(tool, [str(flight), str(other), "--json"]) == 1
    digests = json.loads(capsys.readouterr().out)["digests"]
    assert None not in digests
    assert digests[0] != digests[1]


@pytest.mark.parametrize("limit", [MOST_WAITING, 2000])
@pytest.mark.parametrize("place", [0, 1])
def test_states_that_do_not_have_the_digest_in_their_bag_are_damage(
    flight: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    place: int,
    limit: int,
) -> None:
    monkeypatch.setattr(comparison, "pairs", partial(pairs, limit=limit))
    with Run(flight) as run:
        digest = run.state_digest
    with monkeypatch.context() as patch:
        claimed = {"result": {"state_digest": str(digest)}}
        patch.setattr(flight_writer, "result_record", lambda found: claimed)
        change = at(3, 20, speed=with_value(1, 1.5))
        forged = record(tmp_path / "forged", CONFIGURATION, change)
    shuffled = record(tmp_path / "by bird", CONFIGURATION, change, bird_by_bird=True)
    for other in (flight, shuffled):
        runs = [str(other), str(forged)] if place else [str(forged), str(other)]
        assert run_tool(tool, [*runs, "--json"]) == 2
        told = capsys.readouterr()
        assert told.out == ""
        assert told.err.count("\n") == 1
        assert f"{forged} is damaged, or was changed after its recording" in told.err
        assert str(digest) in told.err


def test_a_repaired_bag_is_not_damaged(
    flight: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    torn = tmp_path / "torn"
    shutil.copytree(flight, torn)
    (torn / "metadata.yaml").unlink()
    (path,) = torn.glob("*.mcap")
    path.write_bytes(path.read_bytes()[:-400])
    assert run_tool(repair.tool, [str(torn)]) == 0
    repaired = tmp_path / "torn-repaired"
    capsys.readouterr()
    assert run_tool(tool, [str(flight), str(repaired), "--json"]) == 0
    digests = json.loads(capsys.readouterr().out)["digests"]
    assert None not in digests
    assert digests[0] == digests[1]
    with recording(tmp_path / "half", CONFIGURATION, grants=False) as run:
        for row in flown_rows(CONFIGURATION)[:9]:
            run.write_row(row)
    (tmp_path / "half" / "metadata.yaml").unlink()
    assert run_tool(repair.tool, [str(tmp_path / "half")]) == 0
    capsys.readouterr()
    assert run_tool(tool, [str(tmp_path / "half-repaired"), str(flight)]) == 1
