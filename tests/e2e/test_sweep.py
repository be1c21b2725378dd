# SPDX-License-Identifier: Apache-2.0
"""A sweep writes one dataset. Each member equals the reference alone, also after kills."""

from __future__ import annotations

import itertools
import os
import signal
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from flock_sim.analysis.verdict import WORDS
from flock_sim.commands import reference
from flock_sim.console.arguments import run_tool
from flock_sim.errors import FlockError
from flock_sim.recording.run import Run
from support.terminal import Job, Terminal

RATIOS, DELAYS = ("0.97", "1.0", "1.04"), ("0", "3")
STEPS = 24_000
"""Steps of a flight of some 4 s: a kill that waits for its first states does not come too late."""
FILE = f"""\
flock:
  birds: 3
  t_max: {STEPS}
  record_every: 10
  links: ["linear:interval=2,drop=0.2"]
axes:
  lambda_2: [{", ".join(RATIOS)}]
  link.delay: [{", ".join(DELAYS)}]
"""


def last_step(bag: Path) -> int:
    try:
        return Run(bag).at().step
    except FlockError:
        return -1


def started(terminal: Terminal, *arguments: str) -> Job:
    (terminal.directory / "s.yaml").write_text(FILE)
    return terminal.start("sweep", "s.yaml", "--members-at-once", 3, "--json", *arguments)


def assert_members_are_those_of_the_reference(terminal: Terminal) -> None:
    with xr.open_dataset(terminal.directory / "runs/s/sweep.nc", engine="scipy") as found:
        assert dict(found.sizes) == {"span_ratio_2": 3, "link_delay": 2, "bird": 3, "gap": 2}
        for (i, ratio), (j, delay) in itertools.product(enumerate(RATIOS), enumerate(DELAYS)):
            bag = terminal.directory / f"{i}{j}"
            flock = ["--birds", "3", "--t-max", str(STEPS), "--record-every", "10"]
            link = ["--link", f"linear:interval=2,drop=0.2,delay={delay}"]
            ratios = ["--span-ratio", f"2={ratio}"]
            assert run_tool(reference.tool, [*flock, *ratios, *link, "--output", str(bag)]) == 0
            with Run(bag) as run:
                end, metrics, verdicts = run.at(), run.metrics(), run.verdicts()
            member = found.isel(span_ratio_2=i, link_delay=j)
            assert (member.span_ratio_2, member.link_delay) == (float(ratio), float(delay))
            assert np.array_equal(member.position, end.position[:, 0])
            assert np.array_equal(member.speed, end.speed[:, 0])
            for name in ("mean_speed", "speed_std", "spacing", "drag_reduction"):
                assert np.array_equal(member[name], getattr(metrics, name)[0]), name
            assert bool(member.holds) == metrics.stable[0]
            assert WORDS[int(member.verdict)] == verdicts.verdict[0]


def kill(job: Job) -> None:
    os.kill(job.process.pid, signal.SIGKILL)
    job.wait()


@pytest.mark.slow
def test_a_sweep_killed_at_any_time_goes_on_by_the_same_command(terminal: Terminal) -> None:
    runs = terminal.directory / "runs/s"
    job = started(terminal)
    job.until(lambda: job.workers("flock_sim.commands.fly"))
    kill(job)

    job = started(terminal)
    job.until(lambda: last_step(runs / "flight_02") > 0)
    first = (runs / "flight_01" / "flight_01_0.mcap").stat()
    kill(job)
    assert not (runs / "sweep.nc").exists()

    done = started(terminal).wait()
    assert done.status == 0, done.stderr
    assert done.json["members"] == 6
    assert (done.json["flights"], done.json["flights_flown"]) == (2, 1)
    assert "continuing runs/s/flight_02" in done.stderr
    assert (runs / "flight_01" / "flight_01_0.mcap").stat().st_mtime_ns == first.st_mtime_ns
    assert (runs / "sweep.png").read_bytes().startswith(b"\x89PNG")
    assert_members_are_those_of_the_reference(terminal)

    done = started(terminal, "--reference", "--output", "runs/r").wait()
    assert done.json["flights_flown"] == 2
    names = ("runs/s/sweep.nc", "runs/r/sweep.nc")
    ours, theirs = (xr.load_dataset(terminal.directory / name, engine="scipy") for name in names)
    for found in (ours, theirs):
        del found.attrs["command"]
    assert theirs.identical(ours)


MANY = """\
flock: {birds: 3, t_max: 200000, record_every: 2000}
axes:
  lambda_2: {from: 0.97, to: 1.04, count: 300}
"""


@pytest.mark.slow
def test_a_sweep_of_the_reference_killed_in_flight_flies_the_rest(terminal: Terminal) -> None:
    (terminal.directory / "many.yaml").write_text(MANY)
    command = ("sweep", "many.yaml", "--members-at-once", 8, "--reference", "--json")
    results = terminal.directory / "runs/many/sweep.npz"
    job = terminal.start(*command)
    job.until(results.exists)
    kill(job)
    with np.load(results) as stored:
        flown = int(stored["flown"].sum())
    assert 0 < flown < 300

    job = terminal.start(*command)
    job.until_said("300 members")
    job.interrupt()
    assert job.wait().status == 130
    with np.load(results) as stored:
        assert int(stored["flown"].sum()) >= flown

    done = terminal.start(*command).wait()
    assert done.status == 0, done.stderr
    assert done.json["flights"] == 38
    assert 0 < done.json["flights_flown"] <= 38 - flown // 8
    assert not list((terminal.directory / "runs/many").glob("flight_*"))
