# SPDX-License-Identifier: Apache-2.0
"""For random configurations, every way to fly gives the states of the reference.

FLOCK_RANDOM_FLIGHTS=N flies N configurations instead of a few.
"""

from __future__ import annotations

import os
from dataclasses import replace
from itertools import product
from pathlib import Path
from random import Random

import numpy as np
import pytest
import xarray as xr
import yaml

from flock_sim.commands import reference
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.configuration.parameter_file import text
from flock_sim.console.arguments import run_tool
from flock_sim.recording.run import Run
from flock_tools.testing import fly
from support.bags import assert_equal
from support.random_flights import random_flight
from support.terminal import Job, Terminal

COUNT = int(os.environ.get("FLOCK_RANDOM_FLIGHTS", "8"))


def written(terminal: Terminal, name: str, flight: FlockConfiguration) -> Path:
    """Write the configuration file NAME.yaml, and fly the reference in bag NAME."""
    file = terminal.directory / f"{name}.yaml"
    file.write_text(text(flight.parameters()), encoding="utf-8")
    bag = terminal.directory / name
    assert run_tool(reference.tool, ["--config", str(file), "--output", str(bag)]) == 0
    return file


def fly_by_hand(terminal: Terminal, birds: int, file: Path, order: Random) -> None:
    """Start clock, recorder and each bird as a process of its own, in any order."""
    tools = [("clock", []), ("recorder", ["-p", "output:=by-hand"])]
    tools += [("bird", ["-p", f"index:={bird}"]) for bird in range(1, birds + 1)]
    jobs: list[Job] = []
    for tool, own in order.sample(tools, k=len(tools)):
        jobs.append(terminal.start(tool, "--ros-args", *own, "--params-file", file))
    for job in jobs:
        assert job.wait().status == 0, job.stderr


@pytest.mark.parametrize(
    "seed",
    [pytest.param(seed, marks=pytest.mark.slow if seed > 0 else []) for seed in range(COUNT)],
)
def test_a_random_flight_is_that_of_the_reference_however_it_is_flown(
    terminal: Terminal, seed: int
) -> None:
    random = Random(seed)
    flight = random_flight(random)
    file = written(terminal, "reference", flight)
    terminal.well("fly", "--config", file, "--output", "one-process")
    processes = random.randint(1, flight.birds)
    terminal.well("fly", "--config", file, "--processes", processes, "--output", "processes")
    fly_by_hand(terminal, flight.birds, file, random)
    fly(flight, output=terminal.directory / "harness")
    states = flight.birds * (flight.steps // flight.record_every + 1)
    for bag in ("one-process", "processes", "by-hand", "harness"):
        assert_equal(terminal, bag, "reference", states)


@pytest.mark.parametrize("seed", range(-(-COUNT // 4)))
@pytest.mark.slow
def test_a_sweep_flies_the_members_of_random_flights(terminal: Terminal, seed: int) -> None:
    random = Random(1000 + seed)
    flight = random_flight(random, members=1)
    every = random.choice([k for k in range(1, flight.steps + 1) if flight.steps % k == 0])
    flight = replace(flight, record_every=every)
    bird = random.randint(1, flight.birds)
    moved = [round(random.uniform(-0.2, 0.2), 3) for _ in range(2)]
    faster = [round(random.uniform(-0.01, 0.01), 5) for _ in range(2)]
    what = {
        "flock": {key: value for key, value in flight.parameters().items() if value != []},
        "axes": {f"position[{bird}]": moved, f"speed[{bird}]": faster},
    }
    (terminal.directory / "s.yaml").write_text(yaml.safe_dump(what), encoding="utf-8")
    terminal.well("sweep", "s.yaml", "--output", "swept")
    with xr.open_dataset(terminal.directory / "swept/sweep.nc", engine="scipy") as found:
        for (i, position), (j, speed) in product(enumerate(moved), enumerate(faster)):
            start = (f"{bird}@0={position},0", f"{bird}@0=0,{speed}")
            alone = replace(flight, perturbations=(*flight.perturbations, *start))
            written(terminal, f"alone-{i}{j}", alone)
            with Run(terminal.directory / f"alone-{i}{j}") as run:
                end = run.at()
            member = found.isel({f"initial_position_{bird}": i, f"initial_speed_{bird}": j})
            assert np.array_equal(member.position, end.position[:, 0])
            assert np.array_equal(member.speed, end.speed[:, 0])
