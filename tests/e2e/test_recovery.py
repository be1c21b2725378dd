# SPDX-License-Identifier: Apache-2.0
"""Killed processes are restarted, and the bag at the end is equal bit for bit."""

from __future__ import annotations

import os
import signal
import time
from contextlib import suppress
from pathlib import Path

import pytest

from flock_sim.recording.run import Run
from support.bags import assert_stopped_as_the_reference, last_step
from support.terminal import Job, Terminal
from support.visitor import Visitor
from torture import kill as kill_if_there
from torture import torture

BIRD = "flock_sim.nodes.bird_process"
RECORDER = "flock_sim.nodes.recorder_process"

STEPS = 12_000
ENDLESS = ("--birds", 3, "--t-max", 1e8, "--record-every", 10, "--span-ratio", "2=0.97,1.03")
"""No kill comes too late for it."""
FLOCK = (*ENDLESS, "--t-max", STEPS)


def in_flight(terminal: Terminal, *how: object, flock: tuple[object, ...] = FLOCK) -> Job:
    """Start a flight, and wait until some of it is on disk."""
    job = terminal.start("fly", *flock, *how, "--output", "bag", "--json")
    job.until(lambda: last_step(terminal.directory / "bag") > 0)
    return job


def kill(*pids: int) -> None:
    for pid in pids:
        os.kill(pid, signal.SIGKILL)


def assert_as_undisturbed(terminal: Terminal) -> None:
    """The bag is complete, and equals the reference's: each state once, every bit."""
    terminal.well("reference", *FLOCK, "--output", "reference")
    done = terminal.run("compare", "bag", "reference", "--json")
    assert done.status == 0, done.stdout + done.stderr
    assert done.json["messages"] == 3 * (STEPS // 10 + 1)
    with Run(terminal.directory / "bag") as run:
        assert run.missing is None


@pytest.mark.parametrize(
    "who",
    [
        "a bird",
        pytest.param("the recorder", marks=pytest.mark.slow),
        pytest.param("birds and recorder at once", marks=pytest.mark.slow),
    ],
)
def test_who_is_killed_is_started_again_and_no_bit_changes(
    terminal: Terminal, visitor: Visitor, who: str
) -> None:
    job = in_flight(terminal, "--processes", 2, flock=ENDLESS)
    killed = []
    if who != "the recorder":
        killed.append(job.workers(BIRD)[0])
    if who != "a bird":
        killed += job.workers(RECORDER)
    kill(*killed)
    job.until(lambda: job.stderr.count("was killed by SIGKILL: started again") == len(killed))
    before = last_step(terminal.directory / "bag")
    job.until(lambda: last_step(terminal.directory / "bag") > before)
    visitor.stop(job)
    done = job.wait()
    assert done.json["restarts"] == len(killed)
    assert done.json["rewinds"] >= 1
    assert_stopped_as_the_reference(terminal, 3, 10, *ENDLESS)


@pytest.mark.slow
def test_a_bird_that_dies_again_and_again_ends_the_flight(terminal: Terminal) -> None:
    job = in_flight(terminal, "--processes", 3, flock=ENDLESS)
    (poor, *_) = job.workers(BIRD)
    words = Path(f"/proc/{poor}/cmdline").read_bytes()
    deadline = time.monotonic() + 60.0
    while job.running:
        assert time.monotonic() < deadline, job.stderr
        for pid in job.workers(BIRD):
            with suppress(OSError):  # it may have ended meanwhile
                if Path(f"/proc/{pid}/cmdline").read_bytes() == words:
                    kill(pid)
        time.sleep(0.01)  # between two looks for a process, which nothing announces
    done = job.wait()
    assert done.status == 1
    assert "was killed by SIGKILL, 6 times without any progress in between" in done.error
    with Run(terminal.directory / "bag") as run:
        assert run.bag.missing is None


@pytest.mark.parametrize("moment", ["at once", "starting", "flying", "ending"])
@pytest.mark.slow
def test_a_flight_killed_as_a_whole_is_resumed(terminal: Terminal, moment: str) -> None:
    bag = terminal.directory / "bag"
    job = terminal.start("fly", *FLOCK, "--processes", 2, "--output", "bag")
    if moment == "at once":
        job.until_said("recording to")
    elif moment == "starting":
        job.until(lambda: len(job.workers(BIRD)) == 2)
        job.workers(BIRD)
    else:
        job.until(lambda: last_step(bag) >= (10 if moment == "flying" else STEPS - 2000))
    job.kill()
    on_disk = last_step(bag)
    done = terminal.run("fly", "--resume", "bag", "--json")
    assert done.status == 0, done.stderr
    assert done.json["steps"] == STEPS
    assert "continuing bag" in done.stderr or on_disk == STEPS
    assert_as_undisturbed(terminal)


@pytest.mark.slow
def test_a_flight_that_was_interrupted_is_resumed_as_often_as_one_likes(
    terminal: Terminal, visitor: Visitor
) -> None:
    job = in_flight(terminal, flock=ENDLESS)
    for processes in (3, 1):
        job.interrupt()
        assert job.wait().status == 130
        before = last_step(terminal.directory / "bag")
        job = terminal.start("fly", "--resume", "bag", "--processes", processes)
        job.until(lambda before=before: last_step(terminal.directory / "bag") > before)
    visitor.stop(job)
    assert job.wait().status == 0
    assert_stopped_as_the_reference(terminal, 3, 10, *ENDLESS)


def test_a_flight_that_is_complete_is_not_resumed(terminal: Terminal) -> None:
    terminal.well("fly", "--birds", 3, "--t-max", 100, "--output", "bag")
    again = terminal.well("fly", "--resume", "bag", "--json")
    assert "bag is complete: there is nothing to continue" in again.stderr
    assert again.json["steps"] == 100


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["--resume", "nowhere"], ["nowhere", "nothing to continue", "--output nowhere"]),
        (["--resume", "empty"], ["empty", "nothing to continue"]),
        (["--resume", "reference"], ["reference", "not recorded by fly"]),
        (["--resume", "reference", "--birds", 4], ["--birds", "--resume", "exclude"]),
        (["--resume", "reference", "--output", "x"], ["--output", "--resume", "exclude"]),
    ],
    ids=str,
)
def test_what_cannot_be_resumed_is_refused_in_one_line(
    terminal: Terminal, arguments: list[object], named: list[str]
) -> None:
    (terminal.directory / "empty").mkdir()
    terminal.well("reference", "--birds", 2, "--t-max", 20, "--output", "reference")
    done = terminal.run("fly", *arguments)
    assert done.status == 2
    assert [word for word in named if word not in done.error] == [], done.error
    assert done.stderr == done.error + "\n"


@pytest.mark.slow
def test_a_short_torture(terminal: Terminal) -> None:
    said: list[str] = []
    how = {"per_flight": 4, "lengths": [8000], "pace": 3.0}
    toll = torture(terminal, seed=2, kills=8, **how, say=said.append)
    assert toll.killed == 8
    assert toll.flights == len(said) >= 2  # one by `fly`, one by hand, more where they are fast
    assert toll.rewinds >= 1


def test_a_kill_that_comes_too_late_is_no_error_of_the_torture(terminal: Terminal) -> None:
    job = terminal.start("reference", "--birds", 2, "--t-max", 10, "--output", "bag")
    pid = job.process.pid
    assert job.process.wait() == 0
    assert job.kill().status == 0
    job.interrupt()
    assert not kill_if_there(pid)
