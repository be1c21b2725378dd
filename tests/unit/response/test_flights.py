# SPDX-License-Identifier: Apache-2.0
"""The linear response is that of flights: sines at five frequencies, and gusts."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.physics.flock import Flock
from flock_sim.reference.integrator import Reference
from flock_sim.response.linear_response import frequency_response, linear_response
from flock_sim.theory.delayed.stability import steady_flight

STEPS_A_PERIOD = (120, 240, 480, 720, 1440)
"""All divide the time over which the response is taken."""

SETTLING, TAKEN = 60_000, 14_400
"""Steps of a flight before and while the response is taken: the slowest mode decays by e^-36."""

LATE = 4
"""With the lag it decays by 1.27e-4 a step: the flight settles for four times as long, by e^-30."""

CHANGE = 1e-4
"""Largest amplitude of a gap in the sines, in b: so small are the quadratic terms."""

ROUNDED = 1e-9
"""Bound on the effect of rounding on an amplitude: an ulp of a position of 3e5 is 6e-11, and the
slow modes sum up the rounding of hundreds of steps."""


def settling(links: tuple[str, ...]) -> int:
    return SETTLING * (LATE if links else 1)


def flown(coupling: str, links: tuple[str, ...], forcing: tuple[str, ...]) -> FlockConfiguration:
    # The lag makes a flock so soft that a longer one settles too slowly for a test.
    birds, spans = (2, ("2=0.98",)) if links else (5, ("2=0.99", "4=1.005"))
    return FlockConfiguration(
        birds=birds,
        coupling=coupling,
        t_max=float(settling(links) + TAKEN),
        record_every=10,
        span_ratios=spans,
        links=links,
        forcing=forcing,
    )


def series(configuration: FlockConfiguration) -> tuple[np.ndarray, np.ndarray]:
    """Times, and speeds and gaps (times, 2 birds - 1, members), once the flight has settled."""
    first = settling(configuration.links)
    states = [state for state in Reference(configuration).fly() if state.step >= first]
    speed = np.array([state.speed for state in states])
    gap = np.array([np.diff(state.position, axis=0) for state in states])
    return np.array([state.time for state in states]), np.concatenate([speed, gap], axis=1)


@pytest.mark.parametrize(
    ("coupling", "links", "lag", "bird"),
    [
        *(("nearest", (), 0.0, bird) for bird in (3, 5)),
        *(("all", (), 0.0, bird) for bird in (3, 5)),
        *(("nearest", ("exact:delay=20",), 20.0, bird) for bird in (1, 2)),
    ],
)
def test_gain_and_phase_of_a_sine_are_those_of_flights(
    coupling: str, links: tuple[str, ...], lag: float, bird: int
) -> None:
    flock = Flock.of(flown(coupling, links, ()))
    spacing, speed = steady_flight(flock, lag, "hold")
    state = SimpleNamespace(spacing=spacing[:, np.newaxis], speed=np.array([speed]))
    omegas = 2.0 * np.pi / np.array(STEPS_A_PERIOD)
    theory = frequency_response(flock, state, omegas, lag=lag, model="hold")[:, :, bird - 1]
    largest = np.abs(theory[:, flock.birds :]).max(axis=1)
    amplitudes = CHANGE / largest * flock.coefficients[bird - 1, 0, 0]

    told = [f"{a!r}" for a in amplitudes.tolist()], map(str, STEPS_A_PERIOD)
    sine = "{}=sine:amplitude={},period={}".format(bird, *map("/".join, told))
    time, values = series(flown(coupling, links, (sine,)))
    _, still = series(flown(coupling, links, ()))
    for m, (omega, expected) in enumerate(zip(omegas, theory)):
        change = (values[:, :, m] - still[:, :, 0]) / (CHANGE / largest[m])
        wave = np.exp(-1j * omega * time[:-1])
        # sin = Im exp(i omega t): the response is the imaginary part of its complex amplitude.
        found = 2.0j * np.mean(wave[:, np.newaxis] * change[:-1], axis=0)
        wrong = np.abs(found - expected) > 1e-3 * np.abs(expected) + ROUNDED / CHANGE * largest[m]
        assert not wrong.any(), (omega, wrong.nonzero(), found[wrong], expected[wrong])


MEMBERS = 128
"""Number of independent flights in gusts."""

STD = 1e-7
"""Of the gusts: gaps change by 1e-4 b, with the lag by 1e-3 b."""


@pytest.mark.parametrize(
    ("coupling", "links", "lag", "steps"),
    [
        ("nearest", (), 0.0, 20_000),
        ("all", (), 0.0, 20_000),
        pytest.param("nearest", ("exact:delay=20",), 20.0, 150_000, marks=pytest.mark.slow),
    ],
)
def test_gaps_in_gusts_have_the_standard_deviations_of_theory(
    coupling: str, links: tuple[str, ...], lag: float, steps: int
) -> None:
    seeds = "/".join(map(str, range(1, MEMBERS + 1)))
    forced = replace(flown(coupling, links, (f"gust:std={STD},seed={seeds}",)), t_max=float(steps))
    flights = zip(Reference(forced).fly(), Reference(replace(forced, forcing=())).fly())
    first = steps // 3  # twice the time in which the slowest mode's variance becomes stationary
    gaps = np.array(
        [
            np.diff(shaken.position - still.position, axis=0)
            for shaken, still in flights
            if shaken.step >= first
        ]
    )
    square = (gaps**2).mean(axis=0)  # of each gap and member; the mean of a linear response is 0
    found = linear_response(Flock.of(flown(coupling, links, ())), lag=lag, model="hold", gust=STD)
    ratio = square / found.gust.gap_std[0][:, np.newaxis] ** 2
    error = ratio.std(axis=1, ddof=1) / np.sqrt(MEMBERS)
    assert error.max() <= 0.04  # of the square: 2 % of the standard deviation
    assert np.abs(ratio.mean(axis=1) - 1.0).max() <= 3.0 * error.max()
