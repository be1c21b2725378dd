# SPDX-License-Identifier: Apache-2.0
"""Free flights: complete bags, possible ages, states near the lockstep flight, no recovery."""

from __future__ import annotations

import math
import os
import signal
from pathlib import Path

import numpy as np
import pytest

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.physics.arrays import FloatArray
from flock_sim.physics.flock import Flock
from flock_sim.recording.run import Run
from support.bags import last_step
from support.terminal import Terminal

BIRD = "flock_sim.nodes.bird_process"
STEPS, EVERY = 60, 5
FLOCK = ("--birds", 3, "--t-max", STEPS, "--record-every", EVERY, "--span-ratio", "1=1.0,1.02")
FREE = ("--mode", "free", "--link", "hold", "--real-time-factor")


def states(path: Path) -> FloatArray:
    """Position and speed at all recorded steps: shape (rows, 2, birds, members)."""
    with Run(path) as run:
        return np.array([(row.position, row.speed) for row in run.snapshots()])


def largest_deviation(flown: FlockConfiguration) -> tuple[float, float]:
    """How far off lockstep any bird can be at the end, in position and speed, whatever it heard.

    Birds begin at the speed at which they would fly alone and only ever save drag, so none is
    slower and no circulation, heard or its own, larger than at the start; a neighbour saves a bird
    between 0 and 2 |E| Gamma^2 / (4 pi). Self-drag grows with speed, and makes differences less.
    """
    flock = Flock.of(flown)
    circulation = flock.coefficients[:, 4].max() / flock.scales.cruise_speed
    pair = 2.0 * np.abs(flock.even).max() * circulation**2 / (4.0 * math.pi)
    acceleration = 2.0 * pair / flock.coefficients[:, 0].min()  # of two neighbours
    return 0.5 * acceleration * flown.t_max**2, acceleration * flown.t_max


def test_a_free_flight_is_recorded_and_measured_and_near_the_lockstep_one(
    terminal: Terminal,
) -> None:
    done = terminal.well("fly", *FLOCK, *FREE, 10, "--processes", 2, "--output", "bag", "--json")
    assert done.json["mode"] == "free"
    assert done.json["rewinds"] == 0
    bag = terminal.directory / "bag"
    with Run(bag) as run:
        assert run.missing is None
        flown, ages = run.configuration, list(run.ages())
        assert run.real_time_factor == 10.0
    assert [(bird, told.step) for bird, told in ages] == [
        (bird, step) for step in range(0, STEPS + 1, EVERY) for bird in (1, 2, 3)
    ]
    for _, told in ages:
        assert np.all((told.age >= 0.0) & (told.age <= told.age_max) & np.isfinite(told.age_max))

    metrics = terminal.well("metrics", "bag", "--json").json
    links = [(link["source"], link["target"]) for link in metrics["links"]]
    assert links == [(2, 1), (1, 2), (3, 2), (2, 3)]
    unit = flown.second / 10.0
    assert metrics["age_seconds"]["max"] == pytest.approx(unit * metrics["age"]["max"], rel=1e-12)
    assert 0.0 <= metrics["age"]["median"] <= metrics["age"]["p95"] <= metrics["age"]["max"]
    assert metrics["age"]["max"] == max(link["max"] for link in metrics["links"])
    assert (metrics["steps_taken"], len(metrics["late_steps"])) == (3 * (STEPS + 1), 3)

    terminal.well("reference", "--repeat", "bag", "--output", "reference")
    off = np.abs(states(bag) - states(terminal.directory / "reference"))
    for k, name in enumerate(("position", "speed")):
        found = metrics["deviation"][name]
        assert found["end"] == off[-1, k].max(axis=0).tolist()
        assert found["max"] == off[:, k].max(axis=(0, 1)).tolist()
        assert max(found["max"]) <= largest_deviation(flown)[k]

    told = terminal.well("metrics", "bag").stdout
    assert "flown freely, at real-time factor 10" in told
    assert "off the same flight in lockstep" in told
    compared = terminal.run("compare", "bag", "reference")
    assert compared.status == 1
    assert "was flown freely" in compared.stderr

    (bag / "metadata.yaml").unlink()
    terminal.well("repair", "bag", "--output", "whole")
    again = terminal.well("metrics", "whole", "--json").json
    assert again == metrics
    resumed = terminal.run("fly", "--resume", "bag")
    assert resumed.status == 2
    assert "a free flight, and the messages that its birds had received are lost" in resumed.stderr


def test_who_is_killed_ends_a_free_flight(terminal: Terminal) -> None:
    job = terminal.start("fly", *FLOCK, *FREE, 0.3, "--output", "bag")
    job.until(lambda: last_step(terminal.directory / "bag") >= 0)
    os.kill(job.workers(BIRD)[0], signal.SIGKILL)
    done = job.wait()
    assert done.status == 1
    assert "the process of birds 1..3 was killed by SIGKILL" in done.stderr
    assert "started again" not in done.stderr
