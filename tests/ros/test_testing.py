# SPDX-License-Identifier: Apache-2.0
"""Flights within this process, the base of users' own experiments and tests."""

from __future__ import annotations

import os
import threading
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
import xarray as xr

from flock_sim.commands import reference
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.configuration.options import FLOCK_OPTIONS
from flock_sim.errors import FlockError, RunFailed
from flock_sim.nodes.bird import BirdNode
from flock_sim.physics import formation
from flock_sim.physics.arrays import FloatArray
from flock_sim.physics.flock import Flock
from flock_sim.physics.stage_kernels import move
from flock_sim.protocol.bird import BirdProtocol
from flock_sim.recording.run import Run
from flock_sim.reference.flock_kernel import add_forces, fill_circulation
from flock_sim.reference.integrator import Reference
from flock_sim.ros.process import new_incarnation
from flock_sim.ros.settings_check import shared_memory
from flock_tools.runs.dataset import load
from flock_tools.testing import fly, ros_alone
from support.own_laws import with_law
from support.terminal import own_domain, ports


@pytest.fixture(autouse=True)
def temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where temporary files go; nothing may be left there."""
    directory = tmp_path / "temporary"
    directory.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(directory))
    return directory


class Watched(BirdNode):
    """A bird that takes note of what its process uses while it is there."""

    ports: ClassVar[set[int]] = set()
    shared: ClassVar[set[str]] = set()
    domains: ClassVar[list[str]] = []

    def __init__(self, *arguments: object, **options: object) -> None:
        super().__init__(*arguments, **options)
        Watched.ports |= ports(os.getpid())
        Watched.shared |= shared_memory()
        Watched.domains.append(os.environ["ROS_DOMAIN_ID"])


@pytest.mark.parametrize(
    "flock",
    [
        {"birds": 4, "t_max": 200, "span_ratios": ["2=0.97,1,1.03"], "coupling": "all"},
        {"birds": 3, "t_max": 100, "record_every": 5, "links": ["hold:interval=3,drop=0.2"]},
        {"birds": 1, "t_max": 10, "record_every": 1, "perturbations": ["1@4=0.1,-0.01"]},
    ],
    ids=["members", "links", "alone"],
)
def test_the_dataset_is_that_of_the_reference_to_the_bit(flock, tmp_path):
    flown = fly(**flock)
    arguments = [
        str(word)
        for key, given in flock.items()
        for value in (given if isinstance(given, list) else [given])
        for word in (FLOCK_OPTIONS[key], value)
    ]
    assert reference.tool([*arguments, "--output", str(tmp_path / "reference"), "--json"]) == 0
    expected = load(tmp_path / "reference")
    xr.testing.assert_identical(flown, expected)
    for name in flown.variables:
        assert flown[name].values.tobytes() == expected[name].values.tobytes(), name


def test_a_second_flight_is_as_the_first_and_nothing_is_left_of_either(monkeypatch, temporary):
    monkeypatch.setenv("ROS_DOMAIN_ID", "142")  # none that a flight looks for
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET")
    monkeypatch.delenv("ROS_STATIC_PEERS", raising=False)
    monkeypatch.setattr(Watched, "ports", set())
    monkeypatch.setattr(Watched, "shared", set())
    monkeypatch.setattr(Watched, "domains", [])
    environment, threads = dict(os.environ), threading.active_count()
    before = ports(os.getpid())
    flock = FlockConfiguration(birds=2, t_max=50.0)
    first = fly(flock, bird=Watched)
    second = fly(flock, bird=Watched)
    xr.testing.assert_identical(first, second)
    assert dict(os.environ) == environment
    assert threading.active_count() == threads
    assert Watched.ports > before  # what others have opened in this process is theirs to close
    assert ports(os.getpid()) == before
    assert not Watched.shared
    assert "142" not in Watched.domains
    assert list(temporary.iterdir()) == []


def test_parameters_win_over_the_configuration_and_the_bag_stays_where_asked(tmp_path):
    flock = FlockConfiguration(birds=2, t_max=50.0)
    flown = fly(flock, t_max=20.0, output=tmp_path / "bag")
    assert flown.time[-1] == 20.0
    with Run(tmp_path / "bag") as run:
        assert run.configuration == FlockConfiguration(birds=2, t_max=20.0)
        assert run.missing is None
    with pytest.raises(FlockError, match="exists"):
        fly(flock, output=tmp_path / "bag")


PULL = """
def pull(bird, neighbours, time):
    total = 0.0
    for k in range(len(neighbours.number)):
        total += neighbours.position[k] - bird.position
    return 0.01 * total + 0.002 * time * (1.2 - bird.speed)


def steady(bird, neighbours, state, speed=1.05):
    error = speed - bird.speed
    force = 0.1 * error + 0.01 * state[0]
    for k in range(len(neighbours.number)):
        force += 0.01 * (neighbours.speed[k] - bird.speed)
    return force, (error,)


def late(bird, time):
    if bird.number == 2 and time > 20.0:
        raise ZeroDivisionError("the experiment has a fault")
    return 0.0
"""


def forced(configuration: FlockConfiguration) -> FloatArray:
    """Speeds of a flock with `pull`, shape (steps + 1, birds, members), flown in one loop."""
    flock, flight = Flock.of(configuration), Reference(configuration)
    x, u, dt = flight.position, flight.speed, configuration.dt
    around = [
        [other - 1 for other in formation.neighbours(bird, flock.birds, configuration.coupling)]
        for bird in range(1, flock.birds + 1)
    ]
    circulation, interactions = np.empty_like(u), flock.interactions(flock.pairs)
    sums = np.empty((2, u.size))
    speeds = [u.copy()]
    for step in range(configuration.steps):
        x_now, u_now = x.copy(), u.copy()
        for stage, node in enumerate((0.0, 0.5, 0.5, 1.0)):
            coefficients = flock.elements.reshape(5, *u.shape)
            for i, others in enumerate(around):
                total = np.zeros(u.shape[1])
                for other in others:
                    total = total + (x_now[other] - x_now[i])
                growing = 0.002 * ((step + node) * dt)
                coefficients[1, i] += 0.01 * total + growing * (1.2 - u_now[i])
            drag = np.zeros_like(u)
            fill_circulation(u_now.ravel(), coefficients[4].ravel(), circulation.reshape(-1))
            add_forces(flock.pairs, x_now, circulation, interactions, drag)
            rows = coefficients.reshape(5, -1)
            start, now = (x.ravel(), u.ravel()), (x_now.reshape(-1), u_now.reshape(-1))
            move(stage, dt, rows, drag.ravel(), *start, *sums, *now)
        x, u = x_now, u_now
        speeds.append(u.copy())
    return np.stack(speeds)


def test_birds_with_a_law_fly_as_the_same_forces_do_in_one_loop_to_the_bit(tmp_path):
    flock = with_law(
        tmp_path,
        PULL,
        "pull",
        birds=4,
        dt=0.5,
        t_max=50.0,
        record_every=1,
        span_ratios=("2=0.97,1.03",),
    )
    flown = fly(flock).speed.values
    np.testing.assert_array_equal(flown, forced(flock))
    assert not np.array_equal(flown, fly(flock, forcing=[]).speed)


def test_a_law_with_a_state_is_flown_over_links_as_in_the_reference_to_the_bit(tmp_path):
    links = ("hold:interval=3,drop=0.2,noise=1e-3",)
    flock = with_law(tmp_path, PULL, "steady", birds=4, t_max=60.0, record_every=3, links=links)
    flown = fly(flock)
    states = list(Reference(flock).fly())
    np.testing.assert_array_equal(flown.speed, [state.speed for state in states])
    expected = [state.forcing_state for state in states]
    np.testing.assert_array_equal(flown.forcing_state, expected)
    assert abs(flown.forcing_state[-1]).min() > 0.1


class OwnProtocol(BirdProtocol):
    """A protocol of the user."""


def with_protocol(bird: int, flown: FlockConfiguration, run_id: int, **options: Any) -> BirdNode:
    """Return a bird of Flock's class with a protocol of the user."""
    protocol = OwnProtocol(bird, flown, run_id, new_incarnation())
    return BirdNode(bird, flown, run_id, protocol=protocol, **options)


@pytest.mark.parametrize(
    ("bird", "name"),
    [(Watched, "Watched"), (partial(Watched), "Watched"), (with_protocol, "OwnProtocol")],
    ids=["class", "factory", "protocol"],
)
def test_the_bag_names_birds_that_are_not_in_flock_and_they_are_not_repeated(bird, name, tmp_path):
    flown = fly(birds=2, t_max=20.0, bird=bird, output=tmp_path / "bag")
    assert flown.attrs["own_parts"] == f"bird {name}"
    again = ["--repeat", str(tmp_path / "bag"), "--output", str(tmp_path / "again")]
    with pytest.raises(FlockError, match=f"flown by birds of {name}, which are not in Flock"):
        reference.tool(again)
    assert not (tmp_path / "again").exists()


@pytest.mark.parametrize(
    ("bad", "words"),
    [
        ({"birdz": 3}, "unknown parameter 'birdz'"),
        ({"birds": 0}, "birds = 0: must be 1 or more"),
        ({"links": ["hald"]}, "unknown model 'hald'"),
        ({"timeout": 0.0}, "timeout 0.0: must be a finite number above 0"),
    ],
)
def test_bad_input_is_refused_in_one_line(bad, words):
    with pytest.raises(FlockError, match=words):
        fly(**bad)


class Broken(BirdNode):
    """A bird that fails in flight."""

    def hear(self, *arguments: Any) -> bool:
        if self.protocol.in_flight:
            raise ZeroDivisionError("the experiment has a fault")
        return super().hear(*arguments)


class Deaf(BirdNode):
    """A bird that hears nothing."""

    def hear(self, *_: object) -> bool:
        return False


def test_what_a_bird_fails_with_is_raised_and_the_next_flight_flies(temporary, tmp_path):
    environment, threads = dict(os.environ), threading.active_count()
    with pytest.raises(RunFailed, match=r"bird 2, step 20: .*late' has raised an exception"):
        fly(with_law(tmp_path, PULL, "late", birds=2, t_max=1000.0))
    with pytest.raises(ZeroDivisionError, match="the experiment has a fault"):
        fly(birds=2, t_max=1000.0, bird=Broken)
    with pytest.raises(RunFailed, match=r"no progress for 0\.5 s, waiting for bird_01, bird_02"):
        fly(birds=2, t_max=10.0, bird=Deaf, timeout=0.5)
    assert fly(birds=2, t_max=10.0).time[-1] == 10.0
    assert dict(os.environ) == environment
    assert threading.active_count() == threads
    assert list(temporary.iterdir()) == []


def test_a_flight_is_on_another_domain_than_a_test_that_has_not_begun_to_talk():
    with own_domain() as domain, ros_alone() as context:
        assert context.get_domain_id() != domain
