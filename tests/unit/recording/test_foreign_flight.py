# SPDX-License-Identifier: Apache-2.0
"""Flights in bags that other programs wrote are read, or made runs again."""

from __future__ import annotations

import random
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest
from mcap.writer import Writer
from rosbags.convert import convert

from flock_sim.bag.reading.reader import BagReader, Recorded
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.configuration.parameter_file import text
from flock_sim.messages import topics
from flock_sim.messages.handshake import handshake
from flock_sim.messages.types import Ages, Grant, Push, State, Wing
from flock_sim.recording.run import Run
from flock_tools.commands import compare, metrics, repair, report
from support.flights import record
from support.tool_runs import error_of, json_of, text_of

CONFIGURATION = FlockConfiguration(
    birds=3, t_max=200.0, record_every=2, span_ratios=("1=0.98,1.0",)
)
LIVE = 77
"""The run id of a live flight."""
NOW = 1_700_000_000 * 10**9
"""The time, in ns, at which a program began to record the live flight."""


@pytest.fixture
def flight(tmp_path: Path) -> Path:
    return record(tmp_path / "run", CONFIGURATION)


def messages(bag: Path) -> list[Recorded]:
    with BagReader(bag) as opened:
        return list(opened.messages())


def grant(configuration: FlockConfiguration = CONFIGURATION, factor: float = 0.0) -> Recorded:
    terms = handshake(configuration, factor)
    said = Grant(LIVE, 0, configuration.steps, configuration.dt, 3, terms)
    return topics.GRANT_TOPIC, 0, said.encode()


def write_theirs(path: Path, told: Sequence[Recorded]) -> Path:
    """Write messages without any record of Flock, as other programs do."""
    kinds = {"wing": Wing, "state": State, "grant": Grant, "perturbation": Push, "ages": Ages}
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2", "theirs")
        channels: dict[str, int] = {}
        for topic, time, data in told:
            if topic not in channels:
                kind = kinds.get(topic.rpartition("/")[2])
                name = kind.TYPE if kind else "rosgraph_msgs/msg/Clock"
                schema = writer.register_schema(name, "ros2msg", b"")
                channels[topic] = writer.register_channel(topic, "cdr", schema)
            writer.add_message(channels[topic], time, data, time)
        writer.finish()
    return path


def live(bag: Path) -> list[Recorded]:
    """Return what ros2 bag record has of the flight in `bag`, which was rewound once.

    Messages come later than they were sent, and those of several birds in any order.
    """
    told: list[Recorded] = [(topics.GRANT_TOPIC, NOW, grant()[2])]
    chance = random.Random(5)
    rows = [(topic, time, data) for topic, time, data in messages(bag)]
    third = len(rows) // 3
    for epoch, part in ((3, rows[: 2 * third]), (4, rows[third:])):
        for topic, _, data in part:
            at = told[-1][1] + 10**6
            if topic.endswith("/state"):
                data = replace(State.decode(data), run_id=LIVE, epoch=epoch).encode()
                at = NOW + len(told) * 10**6 + chance.randrange(4 * 10**6)
            told.append((topic, at, data))
    return told


def test_a_flight_that_was_converted_is_read_by_its_grants(
    flight: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    theirs = write_theirs(tmp_path / "theirs.mcap", [grant(), *messages(flight)])
    with Run(theirs) as run:
        assert run.configuration == CONFIGURATION
        assert run.real_time_factor == 0.0
    found = json_of(metrics.tool, capsys, str(theirs))
    expected = json_of(metrics.tool, capsys, str(flight))
    assert {**found, "state_digest": expected["state_digest"]} == expected
    assert json_of(compare.tool, capsys, str(theirs), str(flight))["equal"] is True
    text_of(report.tool, capsys, str(theirs), "--output", str(tmp_path / "page.html"))


def test_a_converted_reference_is_a_run_again_with_its_configuration(
    flight: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    theirs, again = tmp_path / "theirs", tmp_path / "again"
    convert([flight], theirs, "mcap", 9, None, "file", None, None, (), (), (), ())
    for tool in (metrics.tool, repair.tool):
        line = error_of(tool, capsys, str(theirs))
        assert f"./flock repair {theirs} --config FILE" in line
    file = tmp_path / "flock.yaml"
    file.write_text(text(CONFIGURATION.parameters()), encoding="utf-8")
    facts = json_of(repair.tool, capsys, str(theirs), "--config", str(file), "--output", str(again))
    assert facts["messages"] == len(messages(flight)) == len(messages(again))
    assert json_of(compare.tool, capsys, str(again), str(flight))["equal"] is True
    with Run(again) as run, Run(flight) as flown:
        assert run.state_digest == flown.state_digest
        assert run.missing is None


def test_a_live_flight_that_another_program_recorded_is_a_run_again(
    flight: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    push = Push(LIVE, 10, 0.1, 0.0, number=1, bird=2, member=1)
    stranger = State.decode(next(data for topic, _, data in messages(flight) if "state" in topic))
    told = [
        *live(flight),
        (topics.PERTURBATION_TOPIC, NOW, push.encode()),
        (topics.state_topic(2), NOW + 10**12, replace(stranger, run_id=5).encode()),
        (topics.state_topic(2), NOW + 10**12, b"no state"),
        ("/rosout", NOW, b"a log"),
    ]
    theirs = write_theirs(tmp_path / "theirs.mcap", told)
    line = error_of(metrics.tool, capsys, str(theirs))
    assert f"make a run of it: ./flock repair {theirs}" in line
    facts = json_of(repair.tool, capsys, str(theirs), "--output", str(tmp_path / "again"))
    assert (facts["missing_steps"], facts["left_out"]) == ([], 2)
    assert facts["messages"] == len(messages(flight)) + 1 == len(messages(tmp_path / "again"))
    with Run(tmp_path / "again") as run, Run(flight) as flown:
        assert run.state_digest == flown.state_digest
        assert list(run.wings()) == [1, 2, 3]
        assert [str(push) for push in run.perturbations()] == [str(push.each(2)[0])]


@pytest.mark.parametrize("grants", [True, False])
def test_a_played_flight_that_was_recorded_by_its_clock_is_a_run_again(
    flight: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], grants: bool
) -> None:
    # The times of reception follow /clock, a little late, but for the first row.
    told = [(topic, time and time + 10**4, data) for topic, time, data in messages(flight)]
    theirs = write_theirs(tmp_path / "theirs.mcap", [grant(), *told] if grants else told)
    file = tmp_path / "flock.yaml"
    file.write_text(text(CONFIGURATION.parameters()), encoding="utf-8")
    config = [] if grants else ["--config", str(file)]
    assert "./flock repair" in error_of(metrics.tool, capsys, str(theirs))
    json_of(repair.tool, capsys, str(theirs), "--output", str(tmp_path / "again"), *config)
    assert json_of(compare.tool, capsys, str(tmp_path / "again"), str(flight))["equal"] is True


def test_steps_that_were_not_heard_are_told(
    flight: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lost = [
        each
        for each in live(flight)
        if not (each[0].endswith("02/state") and State.step_of(each[2]) in (0, 50, 52))
    ]
    theirs = write_theirs(tmp_path / "theirs.mcap", lost)
    facts = json_of(repair.tool, capsys, str(theirs), "--output", str(tmp_path / "again"))
    assert facts["missing_steps"] == [0, 50, 52]
    with Run(tmp_path / "again") as run:
        assert [state.step for state in run.snapshots()][:2] == [2, 4]
        assert run.at().step == 200


def test_a_flight_of_another_configuration_is_no_run(
    flight: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    theirs = write_theirs(
        tmp_path / "theirs.mcap", [each for each in live(flight) if each[1] > NOW]
    )
    file = tmp_path / "flock.yaml"
    for change, words in (
        ({"span_ratios": ["1=0.9,1.0"]}, "bird_01 has the span ratio [0.98 1.  ], and the conf"),
        ({"dt": 0.5}, "step 2 is at 0.083333333 s, and at 0.041666667 s by the configuration"),
        ({"span_ratios": ["1=0.98"]}, "bird_01 has the span ratio [0.98 1.  ]"),
        ({"birds": 4}, "no recorded step is complete and fits the configuration"),
    ):
        file.write_text(text({**CONFIGURATION.parameters(), **change}), encoding="utf-8")
        options = ("--config", str(file), "--output", str(tmp_path / "again"))
        assert words in error_of(repair.tool, capsys, str(theirs), *options)
        assert not (tmp_path / "again").exists()
    line = error_of(repair.tool, capsys, str(flight), "--config", str(file))
    assert f"{flight} has its configuration" in line


def test_a_free_flight_is_refused(
    flight: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    told = [(topics.GRANT_TOPIC, NOW, grant(factor=10.0)[2]), *live(flight)[1:]]
    theirs = write_theirs(tmp_path / "theirs.mcap", told)
    assert "a free flight that another program recorded" in error_of(
        repair.tool, capsys, str(theirs)
    )
