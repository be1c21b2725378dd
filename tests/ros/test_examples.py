# SPDX-License-Identifier: Apache-2.0
"""The example scripts, run as a user does. Their output is checked against other computations."""

from __future__ import annotations

import math
import re
import sys
from pathlib import Path

import numpy as np
import pytest

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.physics import formation
from flock_sim.physics.dynamics import acceleration, circulation_at, drag_of_pair
from flock_sim.physics.flock import Flock
from flock_tools.runs.dataset import load
from support.terminal import Terminal

EXAMPLES = Path(__file__).parents[2] / "examples"


def said(terminal: Terminal, script: str) -> str:
    command = [sys.executable, "-P", str(EXAMPLES / script)]
    done = terminal.start_command(script, command).wait()
    assert done.status == 0, done.stdout + done.stderr
    assert done.stderr == ""
    return done.stdout


def numbers(words: str) -> list[float]:
    return [float(word) for word in re.findall(r"\b\d+\.\d{9,}\b", words)]


class Wakes:
    """The drag in a flock of five standard birds with nearest-neighbour coupling."""

    def __init__(self) -> None:
        self.flock = Flock.of(FlockConfiguration(birds=5))
        self.around = [formation.neighbours(bird, 5, "nearest") for bird in range(1, 6)]
        self.lateral, self.even = float(self.flock.lateral[0, 0]), float(self.flock.even[0, 0])
        self.half = float(self.flock.half_span[0, 0])
        mass, thrust, profile, induced, gamma = self.flock.coefficients[0, :, 0].tolist()
        self.body = (mass, thrust, profile, induced)
        self.gamma = gamma

    def drag(self, apart: float, own: float, others: float) -> float:
        """That on a bird whose neighbour is `apart` ahead of it; both with their circulation."""
        half, lateral, even = self.half, self.lateral, self.even
        return float(drag_of_pair(apart, lateral, half, half, even, own, others)[0])


def fading(interval: int, steps: int, memory: float) -> float:
    """The mean speed of five birds in the end: each knows what the others said `interval` ago."""
    wakes = Wakes()
    x = [formation.start_position(bird, 5) for bird in range(1, 6)]
    u = [wakes.flock.scales.cruise_speed] * 5
    for step in range(steps):
        if step % interval == 0:
            told = [(step, *state, circulation_at(state[1], wakes.gamma)) for state in zip(x, u)]
        x_now, u_now = x, u
        sums = np.zeros((2, 5))
        for node, weight, after in ((0, 1, 0.5), (0.5, 2, 0.5), (0.5, 2, 1), (1, 1, 0)):
            slopes = []
            for bird, others in enumerate(wakes.around):
                drag = 0.0
                own = circulation_at(u_now[bird], wakes.gamma)
                for other in others:
                    sent, position, speed, circulation = told[other - 1]
                    age = step - sent + node
                    apart = position + speed * age - x_now[bird]
                    drag += wakes.drag(apart, own, circulation * math.exp(-age / memory))
                slopes.append(acceleration(u_now[bird], drag, *wakes.body))
            sums += weight * np.array([u_now, slopes])
            x_now, u_now = (
                [start + after * slope for start, slope in zip(x, u_now)],
                [start + after * slope for start, slope in zip(u, slopes)],
            )
        x, u = (np.array([x, u]) + sums / 6.0).tolist()
    return float(np.mean(u))


@pytest.mark.slow
def test_the_link_model_is_flown_as_it_is_written(terminal: Terminal) -> None:
    told = said(terminal, "link_model.py")
    assert "equal to the reference to the bit: yes" in told
    expected = [fading(interval, 1000, 20.0) for interval in (1, 10, 30)]
    # Rounding is damped by the flight; the script prints twelve decimals.
    assert numbers(told) == pytest.approx(expected, rel=0, abs=1e-10)


@pytest.mark.slow
def test_the_laws_are_flown_as_they_are_written(terminal: Terminal) -> None:
    """The commands of my_laws.py: all gaps are 0.8 in the end, and all forces balance."""
    laws = EXAMPLES / "my_laws.py"
    terminal.well(
        *("fly", "--birds", 5, "--t-max", 4000, "--output", "mine"),
        *("--forcing", f"3={laws}:cruise:speed=1.1", "--forcing", f"{laws}:follow:gap=0.8"),
    )
    terminal.well("reference", "--repeat", "mine", "--law", laws, "--output", "again")
    terminal.well("compare", "mine", "again")
    end = load(terminal.directory / "mine").isel(time=-1, member=0)
    wakes = Wakes()
    mass, thrust, profile, induced = wakes.body
    speed = float(end.speed[0])
    gamma = circulation_at(speed, wakes.gamma)
    ahead, behind = wakes.drag(0.8, gamma, gamma), wakes.drag(-0.8, gamma, gamma)
    own = thrust - profile * speed**2 - induced / speed**2
    # What is left of the start decays with the slowest root of the loop of gap, speed and integral:
    # m s^3 + damping s^2 + stiffness s + integral = 0.
    slowest = max(np.roots([mass, 0.5, 0.02, 1e-4]).real)
    left = 100.0 * math.exp(slowest * 4000.0)
    gaps = abs(np.diff(end.position))
    assert gaps == pytest.approx([0.8] * 4, rel=0, abs=max(left, 1e-11))
    # The leader cruises, and pulls against the drag of the birds behind it.
    assert own - 2.0 * behind + 0.1 * (1.1 - speed) == pytest.approx(0.0, abs=max(left, 1e-11))
    # The integrals of the others are the forces that hold the gap.
    forces = 1e-4 * end.forcing_state.values[:, 0]
    expected = [ahead - own, ahead + behind - own, 0.0, ahead + behind - own, ahead - own]
    assert forces == pytest.approx(expected, rel=0, abs=max(left, 1e-11))
