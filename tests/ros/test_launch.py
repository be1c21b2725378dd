# SPDX-License-Identifier: Apache-2.0
"""Flights by `ros2 launch`, if it is installed: the wheels do not contain it."""

from __future__ import annotations

import os
import re
import signal
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from flock_sim.launcher.ros2_launch_arguments import ARGUMENTS, PROCESSES
from support.terminal import Job, Terminal, own_domain

pytest.importorskip("ros2launch", reason="ros2 launch is not installed")
pytest.importorskip("launch_ros", reason="launch_ros is not installed")

ROS2 = [sys.executable, "-P", "-c", "import sys; from ros2cli.cli import main; sys.exit(main())"]

DIED = "exit code -9"

FLOCK = "/**: {ros__parameters: {t_max: 200.0, span_ratios: ['2=0.97,1.02']}}"


@pytest.fixture
def flock(terminal: Terminal) -> Path:
    """A configuration file."""
    file = terminal.directory / "flock.yaml"
    file.write_text(FLOCK)
    return file


def launch(terminal: Terminal, file: str, *arguments: str) -> Job:
    """Start `ros2 launch flock_sim FILE ARGUMENTS`."""
    return terminal.start_command("launch", [*ROS2, "launch", "flock_sim", file, *arguments])


def started(job: Job, who: str) -> list[int]:
    """Return the processes that have been started as `who`, in order."""
    found = re.findall(rf"\[{who}-\d+\]: process started with pid \[(\d+)\]", job.stdout)
    return [int(pid) for pid in found]


def the_reference_is_equal(terminal: Terminal, flock: Path, birds: int) -> bool:
    """Whether the bag of the launch is that which `reference` writes."""
    terminal.well("reference", "--config", flock, "--birds", birds, "--output", "reference")
    return terminal.run("compare", "bag", "reference").status == 0


@pytest.mark.parametrize(
    ("file", "known"),
    [("flock.launch.py", ARGUMENTS), ("composed.launch.py", ARGUMENTS | PROCESSES)],
)
def test_a_launch_file_has_the_arguments_that_are_documented(file: str, known: Any) -> None:
    from ament_index_python.packages import get_package_share_directory
    from launch import LaunchContext
    from launch.launch_description_sources import get_launch_description_from_python_launch_file
    from launch.utilities import perform_substitutions

    path = Path(get_package_share_directory("flock_sim")) / "launch" / file
    described = get_launch_description_from_python_launch_file(str(path))
    declared = {
        one.name: (perform_substitutions(LaunchContext(), one.default_value), one.description)
        for one in described.get_launch_arguments()
    }
    assert declared == known


@pytest.fixture
def flight_of_one(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """A flight whose three nodes are there, and of which nothing runs."""
    from launch import LaunchContext

    from flock_sim.launcher.ros2_launch_nodes import Flight

    context = LaunchContext(argv=["birds:=1"])
    context.launch_configurations.update({name: given for name, (given, _) in ARGUMENTS.items()})
    context.launch_configurations["birds"] = "1"
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    with own_domain() as domain:
        monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
        flight = Flight(context, ARGUMENTS)
        assert len([flight.clock(), *flight.recorder(), flight.birds([1])]) == 3
        with flight.held:
            yield flight


def test_a_launch_ends_when_the_last_has_ended_well(flight_of_one: Any) -> None:
    from launch.actions import EmitEvent

    flight = flight_of_one
    assert flight.ended("bird_01", 0) == []
    assert flight.ended("clock", 0) == []
    (end,) = flight.ended("recorder", 0)
    assert isinstance(end, EmitEvent)


def test_what_dies_when_all_is_on_disk_is_not_needed_nor_waited_for_for_ever(
    flight_of_one: Any,
) -> None:
    from launch.actions import EmitEvent, TimerAction

    flight = flight_of_one
    (later,) = flight.ended("recorder", 0)
    assert isinstance(later, TimerAction)
    assert flight.ended("clock", -signal.SIGKILL) == []
    (end,) = flight.ended("bird_01", -signal.SIGKILL)
    assert isinstance(end, EmitEvent)


@pytest.mark.parametrize("status", [-signal.SIGKILL, -signal.SIGSEGV, 128 + signal.SIGTERM])
def test_what_dies_is_started_again_as_often_as_it_dies(flight_of_one: Any, status: int) -> None:
    from launch_ros.actions import Node

    flight = flight_of_one
    for who in ("bird_01", "clock", "recorder") * 2:
        _said, again = flight.ended(who, status)
        assert isinstance(again, Node)


@pytest.mark.parametrize(
    ("file", "more"), [("flock.launch.py", ()), ("composed.launch.py", ("processes:=2",))]
)
def test_a_launched_flight_is_the_reference_and_ends_by_itself(
    terminal: Terminal, flock: Path, file: str, more: tuple[str, ...]
) -> None:
    done = launch(terminal, file, "birds:=3", "config:=flock.yaml", "output:=bag", *more).wait()
    assert done.status == 0, done.stdout + done.stderr
    assert "[ERROR]" not in done.stdout + done.stderr
    assert the_reference_is_equal(terminal, flock, 3)


def test_without_a_recorder_no_bag_is_written(terminal: Terminal, flock: Path) -> None:
    told = ("birds:=2", "config:=flock.yaml", "output:=bag", "record:=false")
    done = launch(terminal, "composed.launch.py", *told).wait()
    assert done.status == 0, done.stdout + done.stderr
    assert list(terminal.directory.iterdir()) == [flock]


def test_a_bird_that_dies_before_the_flight_is_started_again(
    terminal: Terminal, flock: Path
) -> None:
    told = ("birds:=3", "config:=flock.yaml", "output:=bag")
    job = launch(terminal, "flock.launch.py", *told)
    (bird,) = job.until(lambda: started(job, "bird_02"))
    os.kill(bird, signal.SIGKILL)
    done = job.wait()
    assert done.status == 0, done.stdout + done.stderr
    assert done.stdout.count(DIED) + done.stderr.count(DIED) == 1
    assert len(started(job, "bird_02")) == 2
    assert len(started(job, "bird_01")) == 1
    assert the_reference_is_equal(terminal, flock, 3)


@pytest.mark.parametrize("who", ["bird_02", "clock", "recorder"])
def test_what_dies_in_flight_is_started_again_and_changes_no_bit(
    terminal: Terminal, flock: Path, who: str
) -> None:
    flock.write_text(FLOCK.replace("200.0", "20000.0"))
    told = ("birds:=3", "config:=flock.yaml", "output:=bag")
    job = launch(terminal, "flock.launch.py", *told)
    bag = terminal.directory / "bag" / "bag_0.mcap"
    job.until(lambda: bag.exists() and bag.stat().st_size > 100_000)  # a tenth of the flight or so
    (pid,) = started(job, who)
    os.kill(pid, signal.SIGKILL)
    done = job.wait()
    assert done.status == 0, done.stdout + done.stderr
    assert len(started(job, who)) == 2
    assert the_reference_is_equal(terminal, flock, 3)


def test_a_node_that_dies_ends_a_launch_that_is_not_to_respawn(
    terminal: Terminal, flock: Path
) -> None:
    told = ("birds:=3", "config:=flock.yaml", "output:=bag", "respawn:=false")
    job = launch(terminal, "flock.launch.py", *told)
    (bird,) = job.until(lambda: started(job, "bird_02"))
    os.kill(bird, signal.SIGKILL)
    done = job.wait()
    assert done.status == 1
    assert "bird_02 was killed by SIGKILL: fly again" in done.stdout + done.stderr
    assert len(started(job, "bird_02")) == 1


def test_a_node_that_refuses_its_input_ends_the_launch(terminal: Terminal, flock: Path) -> None:
    (terminal.directory / "bag").mkdir()
    (terminal.directory / "bag" / "notes.txt").touch()
    told = ("birds:=3", "config:=flock.yaml", "output:=bag")
    job = launch(terminal, "composed.launch.py", *told)
    done = job.wait()
    assert done.status == 1
    assert "recorder ended with status 2 (bad input)" in done.stdout + done.stderr
    assert "error: output bag" in done.stdout + done.stderr
    assert len(started(job, "recorder")) == 1


@pytest.mark.parametrize(
    ("argument", "named"),
    [
        ("birds:=0", "birds = 0: must be 1 or more"),
        ("config:=missing.yaml", "configuration file missing.yaml: No such file"),
        ("brids:=3", "did you mean 'birds'"),
    ],
)
def test_a_wrong_argument_is_refused_before_anything_starts(
    terminal: Terminal, argument: str, named: str
) -> None:
    done = launch(terminal, "flock.launch.py", argument).wait()
    assert done.status == 1
    said = (done.stdout + done.stderr).splitlines()
    assert len([line for line in said if "[ERROR]" in line and named in line]) == 1, said
    assert "Traceback" not in done.stdout + done.stderr
    assert "process started" not in done.stdout
    assert list(terminal.directory.iterdir()) == []


def test_two_launches_on_one_domain_do_not_touch_each_other(
    terminal: Terminal, flock: Path
) -> None:
    (terminal.directory / "other.yaml").write_text(FLOCK.replace("200.0", "300.0"))
    told = ("birds:=2", "config:=flock.yaml", "output:=one")
    others = ("birds:=2", "config:=other.yaml", "output:=other")
    jobs = [launch(terminal, "flock.launch.py", *words) for words in (told, others)]
    for job in jobs:
        assert job.wait().status == 0, job.stdout + job.stderr
    for file, bag in (("flock.yaml", "one"), ("other.yaml", "other")):
        terminal.well("reference", "--config", file, "--birds", 2, "--output", f"reference-{bag}")
        assert terminal.run("compare", bag, f"reference-{bag}").status == 0


def test_ctrl_c_ends_a_launch_in_order(terminal: Terminal, flock: Path) -> None:
    flock.write_text(FLOCK.replace("200.0", "1e7"))
    told = ("birds:=2", "config:=flock.yaml", "output:=bag")
    job = launch(terminal, "composed.launch.py", *told)
    bag = terminal.directory / "bag" / "bag_0.mcap"
    job.until(lambda: bag.exists() and bag.stat().st_size > 100_000)
    job.interrupt()
    done = job.wait(within=20.0)
    assert done.status == 0
    assert "Traceback" not in done.stdout + done.stderr
    assert "escalating" not in done.stdout + done.stderr
    assert (terminal.directory / "bag" / "metadata.yaml").exists()
