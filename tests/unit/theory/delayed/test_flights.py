# SPDX-License-Identifier: Apache-2.0
"""Flocks over links with a constant lag agree with the theory of lags."""

from math import pi

import numpy as np
import pytest

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.physics import formation
from flock_sim.reference.integrator import Reference
from flock_sim.theory.delayed.stability import crossings, delayed_linearisation, steady_flight
from support.steady_states import flock_of, rate_and_frequency

BIRDS = 3
ALIKE = np.array([1.0, -2.0, 1.0])
"""How the birds move where both wings move alike."""


def steady_start(links: str, dt: float, t_max: float, state: tuple) -> Reference:
    """A flock that has flown in its steady `state` for as long as its links remember."""
    spacing, speed = state
    monolith = Reference(FlockConfiguration(birds=BIRDS, t_max=t_max, dt=dt, links=(links,)))
    position = formation.positions(spacing[:, np.newaxis])
    for _ in range(400):
        monolith.position[:] = position + speed * dt * monolith.step
        monolith.speed[:] = speed
        monolith.advance(1)
    return monolith


def test_a_held_neighbour_biases_the_steady_state_as_its_lag_says():
    # A state that is held through a step is d to d + 1 steps old there. At a fixed lag of d steps
    # it converges to the theory of that lag with order 1, and to that of half a step more with 2.
    by_lag, by_half_a_step_more = [], []
    steps = np.array([0.5, 0.25, 0.125])
    for dt in steps:
        delay = round(1.0 / dt)
        late = steady_flight(flock_of(BIRDS), (delay + 0.5) * dt, "hold")
        monolith = steady_start(f"hold:delay={delay}", dt, 2e4, late)
        monolith.advance(round(2e4 / dt) - monolith.step)
        assert np.ptp(monolith.speed) < 1e-6
        flown = monolith.speed.mean()
        by_lag.append(flown - steady_flight(flock_of(BIRDS), 1.0, "hold")[1])
        by_half_a_step_more.append(flown - late[1])
    assert np.log2(np.divide(by_lag[:-1], by_lag[1:])) == pytest.approx([1.0, 1.0], abs=0.15)
    orders = np.log2(np.divide(by_half_a_step_more[:-1], by_half_a_step_more[1:]))
    assert orders == pytest.approx([2.0, 2.0], abs=0.25)
    assert abs(by_half_a_step_more[-1]) < 1e-4


def flown_root(delays: list[int], dt: float, swings: int = 16) -> list[complex]:
    """The root with which a small swing of both wings grows over `linear` links, by delay.

    Half the difference of two flights pushed by 1e-4 either way: second orders drop out. What
    decays faster has had half of the flight for it.
    """
    members = len(delays)
    links = "linear:delay=" + "/".join(map(str, 2 * delays))
    monolith = steady_start(links, dt, 1e5 * dt, steady_flight(flock_of(BIRDS), 0.0, "linear"))
    push = 1e-4 * np.repeat([1.0, -1.0], members)
    monolith.position += ALIKE[:, np.newaxis] * push
    period = 340.0 / dt
    every = round(period / 8)
    signal = []
    for _ in range(8 * swings):
        spread = ALIKE @ monolith.position
        signal.append(spread[:members] - spread[members:])
        monolith.advance(every)
    found = []
    for late in np.array(signal)[len(signal) // 2 :].T:
        found.append(complex(rate_and_frequency(late, every * dt)))
    return [complex(value.real, abs(value.imag)) for value in found]


def test_three_geese_lose_stability_within_1_percent_of_the_root():
    (crossing,) = crossings(flock_of(BIRDS), [30.0, 60.0], "linear")
    assert 2.0 * pi / crossing.frequency == pytest.approx(340.0, abs=1.0)
    off = []
    for dt in (0.25, 0.125):
        wanted = crossing.lag * np.array([0.95, 0.9925, 1.0075, 1.05])
        delays = np.round(wanted / dt - 0.5).astype(int).tolist()
        lags = (np.array(delays) + 0.5) * dt
        assert np.abs(lags[1:3] / crossing.lag - 1.0).max() < 0.01
        flown = flown_root(delays, dt)
        for lag, value in zip(lags, flown):
            root = delayed_linearisation(flock_of(BIRDS), float(lag), "linear").rightmost_roots()[0]
            assert (value.real > 0.0) == (root.real > 0.0) == (lag > crossing.lag)
            off.append(abs(value - complex(root.real, abs(root.imag))))
    # What is left is of first order in the step, as the rate of circulation is of the step before.
    assert np.divide(off[:4], off[4:]) == pytest.approx([2.0] * 4, rel=0.1)
    assert max(off) < 3e-7
