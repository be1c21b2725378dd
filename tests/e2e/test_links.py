# SPDX-License-Identifier: Apache-2.0
"""Flights over link models equal the reference bit for bit, also if processes are killed."""

from __future__ import annotations

import os
import signal
from collections import Counter

import pytest

from flock_sim.recording.run import Run
from support.bags import assert_stopped_as_the_reference, last_step
from support.terminal import Job, Terminal
from support.visitor import Visitor

BIRD = "flock_sim.nodes.bird_process"
RECORDER = "flock_sim.nodes.recorder_process"

FLOCK = ("--birds", 4, "--record-every", 10, "--span-ratio", "2=0.97,1,1.03")
ENDLESS = 1e8
"""No kill comes too late for a flight of so many steps."""
LONG = 24_000
"""Steps that last for seconds where little is said."""

MIXED = (
    *("--link", "hold:interval=3,delay=5/0/2,jitter=2,drop=0.3,noise=0.01,timeout=40"),
    *("--link", "2->3=linear:drop=0.2,range=5,position_quantum=0.001,seed=1/2/1"),
)
RATIOS = ",".join(f"{0.97 + 0.001 * k:.3f}" for k in range(64))
MANY = (*FLOCK[:-1], f"2={RATIOS}")
LATE_LOSSY_NOISY = ("--link", "hold:delay=5,drop=0.3,noise=0.01")
EXACT_TOO = (*MIXED, "--link", "4->3=exact:delay=1,drop=0.1", "--link", "1->2=exact")


def in_flight(terminal: Terminal, steps: float, *what: object) -> Job:
    job = terminal.start("fly", "--t-max", steps, *what, "--output", "bag", "--json")
    job.until(lambda: last_step(terminal.directory / "bag") > 0)
    return job


def assert_as_the_reference(terminal: Terminal, steps: int, *flock: object) -> None:
    terminal.well("reference", "--t-max", steps, *flock, "--output", "reference")
    done = terminal.run("compare", "bag", "reference", "--json")
    assert done.status == 0, done.stdout + done.stderr
    assert done.json["messages"] == 4 * (steps // 10 + 1)


@pytest.mark.parametrize(
    "flock",
    [
        pytest.param((*FLOCK, *MIXED), id="sparse", marks=pytest.mark.slow),
        pytest.param((*FLOCK, *EXACT_TOO), id="every stage"),
        pytest.param((*MANY, *LATE_LOSSY_NOISY), id="64 members", marks=pytest.mark.slow),
    ],
)
def test_a_flight_over_bad_links_with_kills_is_that_of_the_reference(
    terminal: Terminal, visitor: Visitor, flock: tuple[object, ...]
) -> None:
    bag = terminal.directory / "bag"
    job = in_flight(terminal, ENDLESS, *flock, "--processes", 2)
    for count, module in enumerate((BIRD, RECORDER), 1):
        os.kill(job.workers(module)[0], signal.SIGKILL)
        job.until(lambda count=count: job.stderr.count("started again") == count)
        before = last_step(bag)
        job.until(lambda before=before: last_step(bag) > before)
    visitor.stop(job)
    done = job.wait()
    assert done.json["restarts"] == 2
    assert done.json["rewinds"] >= 1
    assert_stopped_as_the_reference(terminal, 4, 10, *flock)


@pytest.mark.slow
def test_a_flight_over_bad_links_is_gone_on_with_where_it_was_cut_short(terminal: Terminal) -> None:
    job = in_flight(terminal, LONG, *FLOCK, *MIXED, "--processes", 2)
    job.kill()
    done = terminal.run("fly", "--resume", "bag", "--json")
    assert done.status == 0, done.stderr
    assert_as_the_reference(terminal, LONG, *FLOCK, *MIXED)
    terminal.well("reference", "--repeat", "bag", "--output", "again")
    assert terminal.run("compare", "again", "reference").status == 0


def test_messages_over_ros_are_fewer_by_the_stages_and_the_interval(terminal: Terminal) -> None:
    flock = ("--birds", 2, "--t-max", 40, "--record-every", 5, "--record-stages")
    terminal.well("fly", *flock, "--link", "linear:interval=5", "--output", "bag")
    with Run(terminal.directory / "bag") as run:
        counts = Counter(topic for topic, _, _ in run.bag.messages())
    assert counts["/flock/bird_01/stage"] == 40 // 5
