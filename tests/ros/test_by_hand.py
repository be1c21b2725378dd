# SPDX-License-Identifier: Apache-2.0
"""Nodes that are started one at a time, each as a process of its own, as with `ros2 run`."""

from __future__ import annotations

import re
import signal
from pathlib import Path

import pytest

from support.bags import assert_equal, assert_stopped_as_the_reference, last_step
from support.terminal import Job, Terminal
from support.visitor import Visitor

FLOCK = """\
/**:
  ros__parameters:
    birds: 2
    t_max: 200.0
    record_every: 10
    span_ratios: ["2=0.97,1.02"]
"""


@pytest.fixture
def flock(terminal: Terminal) -> Path:
    """A configuration file."""
    file = terminal.directory / "flock.yaml"
    file.write_text(FLOCK)
    return file


def start(terminal: Terminal, flock: Path, who: str) -> Job:
    """Start the clock, the recorder or a bird by hand, and wait until it is on the network."""
    given = {"recorder": ["-p", "output:=bag"], "clock": []}.get(who, ["-p", f"index:={who}"])
    tool = who if who in ("clock", "recorder") else "bird"
    return terminal.start(tool, "--ros-args", *given, "--params-file", flock).until_connected()


@pytest.mark.parametrize(
    "order",
    [("clock", "1", "recorder", "2"), ("recorder", "2", "1", "clock")],
    ids=["clock-first", "clock-last"],
)
def test_nodes_started_in_any_order_fly_the_flight_of_the_reference(
    terminal: Terminal, flock: Path, order: tuple[str, ...]
) -> None:
    jobs = [start(terminal, flock, who) for who in order]
    for job in jobs:
        done = job.wait()
        assert (done.status, done.stdout) == (0, ""), done.stderr
        assert "error" not in done.stderr
    terminal.well("reference", "--config", flock, "--output", "reference")
    done = terminal.run("compare", "bag", "reference", "--json")
    assert done.status == 0, done.stdout
    assert done.json["messages"] == 2 * 21


def test_a_clock_alone_says_whom_it_waits_for_and_gives_up(terminal: Terminal) -> None:
    job = terminal.start("clock", "--timeout", 7, "--ros-args", "-p", "birds:=3")
    job.until_said("waiting for bird_01, bird_02, bird_03")
    done = job.wait()
    assert done.status == 1
    assert "no progress for 7 s" in done.error
    assert "bird_01, bird_02, bird_03" in done.error


def test_a_bird_alone_says_what_it_waits_for_and_gives_up(terminal: Terminal) -> None:
    job = terminal.start("bird", "--ros-args", "-p", "index:=2", "-p", "timeout:=6.0")
    job.until_said("bird_02 waits for the clock's first grant")
    done = job.wait()
    assert done.status == 1
    assert "start what is missing" in done.error


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("tool", ["bird", "clock", "recorder"])
def test_a_node_by_hand_ends_when_it_is_told_to(
    terminal: Terminal, flock: Path, tool: str, number: signal.Signals
) -> None:
    job = start(terminal, flock, "1" if tool == "bird" else tool)
    job.send(number)
    done = job.wait()
    assert done.status == 128 + number
    assert "Traceback" not in done.stderr
    if tool == "recorder":
        assert (terminal.directory / "bag" / "metadata.yaml").exists()


def test_a_bird_of_another_flight_is_refused_by_name(terminal: Terminal, flock: Path) -> None:
    clock = start(terminal, flock, "clock")
    other = ("-p", "index:=1", "--params-file", flock, "-p", "t_max:=100.0")
    done = terminal.run("bird", "--ros-args", *other)
    assert done.status == 2
    assert done.error == (
        "error: bird_01 has t_max = 100.0 where the clock has 200.0: "
        "give both the same configuration"
    )
    clock.send(signal.SIGINT)
    clock.wait()


def test_a_bird_of_other_wings_is_refused_by_name(terminal: Terminal, flock: Path) -> None:
    clock = start(terminal, flock, "clock")
    text = FLOCK.replace("2=0.97,1.02", "2=0.97")
    (terminal.directory / "other.yaml").write_text(text)
    done = terminal.run("bird", "--ros-args", "-p", "index:=1", "--params-file", "other.yaml")
    assert done.status == 2
    assert 'bird_01 has span_ratios = ["2=0.97"] where the clock has ["2=0.97,1.02"]' in done.error
    assert "the same configuration" in done.error
    clock.send(signal.SIGINT)
    clock.wait()


@pytest.mark.parametrize(
    ("tool", "arguments", "named"),
    [
        ("bird", ["-p", "birds:=3", "-p", "index:=4"], ["index = 4", "1..3"]),
        ("bird", ["-p", "birds:=3"], ["index = 0", "1..3"]),
        ("bird", ["-p", "birds:=3", "-p", "index:=one"], ["index = 'one'", "int"]),
        ("bird", ["-p", "indices:=[a, b]"], ["indices = ", "list"]),
        ("bird", ["-p", "brids:=3"], ["'brids'", "did you mean 'birds'"]),
        ("bird", ["-p", "birds=3"], ["'-p birds=3'", "--help"]),
        ("bird", ["--params-file", "missing.yaml"], ["missing.yaml", "--help"]),
        ("bird", ["--no-such-flag"], ["--no-such-flag"]),
        ("bird", ["-p", "index:=1", "-p", "executor:=event"], ["'event'", "did you mean 'events'"]),
        ("clock", ["-p", "window:=0"], ["window", "0", "1 or more"]),
        ("clock", ["-p", "dt:=-1.0"], ["dt = -1", "above 0"]),
        ("recorder", ["-p", "birds:=3"], ["output", "-p output:="]),
    ],
    ids=lambda case: " ".join(case) if isinstance(case, list) else case,
)
def test_bad_parameters_are_refused_in_one_line(
    terminal: Terminal, tool: str, arguments: list[str], named: list[str]
) -> None:
    done = terminal.run(tool, "--ros-args", *arguments)
    assert done.status == 2, done.stderr
    assert done.stderr == done.error + "\n"
    assert done.stdout == ""
    assert [word for word in named if word not in done.error] == [], done.error
    assert list(terminal.directory.iterdir()) == []


EVERY = 30
ENDLESS = f"""\
/**:
  ros__parameters:
    birds: 3
    t_max: 1.0e+8
    record_every: {EVERY}
    span_ratios: ["2=0.97"]
"""
"""What a kill does not come too late for."""


NODES = {
    "clock": ("clock",),
    "recorder": ("recorder", "-p", "output:=bag", "-p", "resume:=true"),
    "bird 1": ("bird", "-p", "index:=1"),
    "bird 2": ("bird", "-p", "index:=2"),
    "bird 3": ("bird", "-p", "index:=3"),
}


def start_endless(terminal: Terminal, who: str) -> Job:
    """Start a node of the flight without an end."""
    file = terminal.directory / "endless.yaml"
    if not file.exists():  # another node may be reading it
        file.write_text(ENDLESS)
    tool, *own = NODES[who]
    return terminal.start(tool, "--ros-args", *own, "--params-file", file.name)


def until_further(terminal: Terminal, recorder: Job) -> None:
    """Wait until there is more of the flight on disk than now."""
    bag = terminal.directory / "bag"
    before = max(0, last_step(bag))
    recorder.until(lambda: last_step(bag) > before)


@pytest.mark.parametrize("killed", ["bird 2", "clock", "recorder"])
@pytest.mark.slow
def test_a_node_that_is_killed_and_started_again_changes_no_bit(
    terminal: Terminal, visitor: Visitor, killed: str
) -> None:
    jobs = {who: start_endless(terminal, who) for who in NODES}
    until_further(terminal, jobs["recorder"])
    jobs[killed].send(signal.SIGKILL)
    assert jobs[killed].wait().status == -signal.SIGKILL
    jobs[killed] = start_endless(terminal, killed)
    until_further(terminal, jobs["recorder"])
    visitor.stop(*jobs.values())
    assert_stopped_as_the_reference(terminal, 3, EVERY, "--config", "endless.yaml")


def test_a_second_clock_leaves_the_flock_to_the_first(terminal: Terminal, visitor: Visitor) -> None:
    jobs = {who: start_endless(terminal, who) for who in NODES}
    until_further(terminal, jobs["recorder"])
    done = start_endless(terminal, "clock").wait()
    assert done.status == 2
    assert re.search(r"another clock controls run \d+: end it first", done.error)
    until_further(terminal, jobs["recorder"])
    visitor.stop(*jobs.values())
    assert_stopped_as_the_reference(terminal, 3, EVERY, "--config", "endless.yaml")


@pytest.mark.parametrize("resume", ["true", "false"])
def test_a_second_recorder_of_the_same_bag_is_refused(
    terminal: Terminal, flock: Path, resume: str
) -> None:
    first = start(terminal, flock, "recorder")
    first.until(lambda: any((terminal.directory / "bag").glob("*.mcap")))
    again = ("-p", "output:=bag", "-p", f"resume:={resume}", "--params-file", flock)
    done = terminal.run("recorder", "--ros-args", *again)
    assert done.status == 2
    assert ("another process is recording to bag" if resume == "true" else "exists") in done.error
    for who in ("clock", "1", "2"):
        start(terminal, flock, who)
    assert first.wait().status == 0, first.stderr
    terminal.well("reference", "--config", flock, "--output", "reference")
    assert_equal(terminal, "bag", "reference", 2 * 21)


def test_a_recorder_keeps_what_is_there(terminal: Terminal) -> None:
    (terminal.directory / "bag").mkdir()
    done = terminal.run("recorder", "--ros-args", "-p", "output:=bag")
    assert done.status == 2
    assert "-p resume:=true" in done.error
    assert "-p force:=true" in done.error


def test_numbers_may_be_written_in_any_usual_way(terminal: Terminal) -> None:
    flight = ("-p", "birds:=1", "-p", "t_max:=1e2", "-p", "dt:=1")
    clock = terminal.start("clock", "--ros-args", *flight, "-p", "record:=false")
    bird = terminal.start("bird", "--ros-args", *flight, "-p", "index:=1")
    assert [job.wait().status for job in (clock, bird)] == [0, 0]
