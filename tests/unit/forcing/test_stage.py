# SPDX-License-Identifier: Apache-2.0
"""The state of laws is integrated like birds, and noise is that of the birds' steps alone."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.forcing.stage import INITIAL, STEP, normals
from flock_sim.physics.arrays import FloatArray
from flock_sim.physics.runge_kutta import NODES, STAGES, TABLEAU
from flock_sim.physics.scaling import BirdCoefficients, Scales
from flock_sim.reference.integrator import Reference
from support.own_laws import with_law

SIGMAS = 5.0
"""Standard errors that an estimate may be off by: by chance in one of two million tests."""

CLOSED_LOOP = """
def law(bird, time, state, wanted=1.1, gain=0.3):
    error = wanted - bird.speed
    return gain * error + 0.1 * state[0] * time, (error + state[1], -0.5 * state[0])
"""


def speeds(flock: FlockConfiguration) -> FloatArray:
    """Return the speed of bird 1, (records, members)."""
    return np.array([state.speed[0] for state in Reference(flock).fly()])


def test_a_state_is_integrated_with_its_bird_by_all_four_stages(tmp_path: Path) -> None:
    """Plain Python with the same tableau, in the order of `stage_kernels.move`, bit for bit."""
    dt, steps = 0.7, 30
    flock = with_law(tmp_path, CLOSED_LOOP, "law", birds=1, dt=dt, t_max=dt * steps, record_every=1)
    constants = BirdCoefficients.of(Scales.of(flock), flock.span_ratio[0]).rows()[:, 0].tolist()
    mass, thrust, profile, induced, _ = constants

    def slopes(time: float, u: float, a: float, b: float) -> tuple[float, float, float]:
        error = 1.1 - u
        force = 0.3 * error + 0.1 * a * time
        pull = thrust + force
        return (
            (pull - (profile * (u * u) + induced / (u * u)) - 0.0) / mass,
            error + b,
            -0.5 * a,
        )

    values = (Scales.of(flock).cruise_speed, 0.0, 0.0)
    for state in Reference(flock).fly():
        assert state.speed[0, 0] == values[0]
        assert state.forcing_state[0, :, 0].tolist() == list(values[1:])
        now, sums = values, (0.0, 0.0, 0.0)
        for stage in range(STAGES):
            rates = slopes((state.step + NODES[stage]) * dt, *now)
            weight, part = TABLEAU[STAGES, stage], TABLEAU[stage + 1, stage]
            sums = tuple(total + weight * rate for total, rate in zip(sums, rates))
            last = stage + 1 == STAGES
            now = tuple(
                start + dt * (total if last else part * rate)
                for start, total, rate in zip(values, sums, rates)
            )
        values = now
    assert abs(values[1]) > 0.05


def drawn(ordinal: int, bird: int, purpose: int = STEP, seed: int = 3) -> FloatArray:
    """Return the noise of a term in 4000 steps, shape (2, steps)."""
    return np.array([normals(seed, bird, ordinal, step, purpose) for step in range(4000)]).T


def test_noise_is_independent_over_birds_terms_and_steps() -> None:
    streams = [
        *(row for bird in (1, 2, 7) for ordinal in (0, 1) for row in drawn(ordinal, bird)),
        *drawn(0, 1, INITIAL),
        *drawn(0, 1, seed=4),
    ]
    # Some streams again, one and two steps later.
    later = [np.roll(row, -lag)[:-2] for lag in (1, 2) for row in streams[:4]]
    numbers = np.array([*(row[:-2] for row in streams), *later])
    count = numbers.shape[1]
    correlation = np.corrcoef(numbers)
    off = correlation[~np.eye(len(numbers), dtype=bool)]
    assert abs(off).max() < SIGMAS / math.sqrt(count)
    assert abs(numbers.mean(axis=1)).max() < SIGMAS / math.sqrt(count)
    assert abs(numbers.var(axis=1) - 1.0).max() < SIGMAS * math.sqrt(2.0 / count)


def test_a_law_gets_the_noise_of_its_bird_and_place_among_seeded_terms(tmp_path: Path) -> None:
    source = """
    def reveal(bird, noise):
        return bird.mass * (noise[0] + 1000.0 * noise[1])
    """
    flock = with_law(tmp_path, source, "reveal:seed=5/6", birds=2, t_max=8.0, record_every=1)
    silent = with_law(tmp_path, source, "reveal:seed=9", 1, birds=2, t_max=8.0, record_every=1)
    more = FlockConfiguration.given(
        {
            **flock.parameters(),
            # Terms without noise, and those of other birds, do not count.
            "forcing": ["constant:force=0", *silent.forcing, *flock.forcing],
        }
    )
    for configuration, ordinals in ((flock, {1: 0, 2: 0}), (more, {1: 1, 2: 0})):
        for bird, ordinal in ordinals.items():
            forced = Reference(configuration)._forced[bird - 1]
            flight = Reference(configuration)
            for step in range(8):
                flight.advance(1)
                noise = flight._forced[bird - 1]._arrays[10]
                for member, seed in enumerate((5, 6)):
                    expected = normals(seed, bird, ordinal, step, STEP)
                    assert tuple(noise[ordinal, :, member]) == expected
            assert forced.words is not flight._forced[bird - 1].words


def test_members_with_equal_seeds_have_equal_gusts() -> None:
    flock = FlockConfiguration(
        birds=2, t_max=50.0, forcing=("gust:std=1e-3,seed=1/2/1", "gust:std=1e-3,time=4,seed=3")
    )
    flight = Reference(flock)
    flight.advance(50)
    assert np.array_equal(flight.speed[:, 0], flight.speed[:, 2])
    assert (flight.speed[:, 0] != flight.speed[:, 1]).all()
    assert flight.speed[0, 0] != flight.speed[1, 0]


def lone_bird(h: float, **more: object) -> tuple[dict[str, object], float]:
    """Return a flock of one bird with a dt of h / a, and a: the damping rate of its speed."""
    scales = Scales.of(FlockConfiguration())
    u = scales.cruise_speed
    rate = 2.0 * scales.drag_coefficient_k * (u - u**-3) / scales.mass_ratio
    return {"birds": 1, "dt": h / rate, "record_every": 1, **more}, rate


def rk4(h: float) -> tuple[float, float]:
    """Return the decay of RK4 in a step for u' = -a u + force, and its gain of a constant force."""
    decay = 1.0 - h + h**2 / 2.0 - h**3 / 6.0 + h**4 / 24.0
    return decay, (1.0 - decay) / h


@pytest.mark.parametrize("h", [0.1, 0.5, 2.0])
@pytest.mark.parametrize("time", [None, 0.3, 3.0])
def test_an_ensemble_in_a_gust_has_the_variance_of_a_linear_bird(
    h: float, time: float | None
) -> None:
    """u' = e u + g I with the integral I of the acceleration; see docs/model.md."""
    members, spread = 3000, 1e-7
    flock, rate = lone_bird(h)
    dt = h / rate
    seeds = "/".join(map(str, range(members)))
    decay, gain = rk4(h)
    if time is None:
        std = spread * math.sqrt(2.0 * rate)
        term = f"gust:std={std!r},seed={seeds}"
        variance = (gain * std) ** 2 * dt / (1.0 - decay**2)
    else:
        tau = time * dt
        std = spread * math.sqrt(rate * (1.0 + rate * tau) / tau)
        term = f"gust:std={std!r},time={tau!r},seed={seeds}"
        d = dt / tau
        integral = 2.0 * (std * tau) ** 2 * (d - 1.0 + math.exp(-d))
        ends = std**2 * tau * (1.0 - math.exp(-d))
        with_state = gain * ends / (1.0 - decay * math.exp(-d))
        crossed = tau * (1.0 - math.exp(-d)) * with_state
        variance = (2.0 * decay * gain * crossed + gain**2 * integral) / (1.0 - decay**2)
    steps = math.ceil(12.0 / min(h, 1.0 / (time or 1.0), -math.log(decay)))
    flight = Reference(FlockConfiguration(**flock, t_max=dt * steps, forcing=(term,)))
    flight.advance(steps)
    u = flight.speed[0] - Scales.of(flight.configuration).cruise_speed
    assert np.var(u) == pytest.approx(variance, rel=SIGMAS * math.sqrt(2.0 / members))
    assert abs(u.mean()) < SIGMAS * math.sqrt(variance / members)
    if h == 0.1 and time != 0.3:
        # ... and that of the continuous process, of which `spread` is the standard deviation.
        assert np.std(u) == pytest.approx(spread, rel=0.5 * SIGMAS * math.sqrt(2.0 / members))


KICK = """
def kick(bird, step_state, size):
    return (bird.mass * size if step_state[0] == 0.0 else 0.0), (1.0,)
"""


def variance_in_white_gusts(h: float, directory: Path) -> float:
    """Return the stationary variance of a lone bird's speed, times 2 a / std^2.

    It is the sum of squares of the responses to the numbers of all past steps; the response to one
    number is that to an acceleration which is constant over one step.
    """
    size, steps = 1e-5, math.ceil(16.0 / h)
    flock, rate = lone_bird(h)
    dt = h / rate
    term = f"kick:size={size / dt}/{-size / dt}"
    flown = speeds(with_law(directory, KICK, term, t_max=dt * steps, **flock))
    response = (flown[1:, 0] - flown[1:, 1]) / (2.0 * size)
    return float(2.0 * h * np.sum(response**2))


def test_the_variance_in_white_gusts_converges_with_the_square_of_dt(tmp_path: Path) -> None:
    """An acceleration that is constant over a step gives (2/h) tanh(h/2) = 1 - h^2 / 12 + ..."""
    errors = []
    for h in (0.4, 0.2, 0.1):
        found = variance_in_white_gusts(h, tmp_path)
        decay, gain = rk4(h)
        # Terms of third order in the size of the response, (1e-5 * 40)^2.
        assert found == pytest.approx(2.0 * h * gain**2 / (1.0 - decay**2), rel=1e-6)
        # RK4 adds h^4 / 120 to the decay rate, and as much to the variance.
        assert found == pytest.approx(2.0 / h * math.tanh(h / 2.0), rel=h**4 / 50.0 + 1e-6)
        errors.append(1.0 - found)
        assert errors[-1] == pytest.approx(h**2 / 12.0, rel=h**2)
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.1)
    assert errors[1] / errors[2] == pytest.approx(4.0, rel=0.03)


def test_the_mean_of_a_step_in_a_white_gust_has_an_error_of_second_order(tmp_path: Path) -> None:
    """f'' std^2 dt^2 / 6 instead of / 4, so what noise does by the curvature of f has order 1."""
    std, dt = 1e-3, 1.0
    nodes, weights = np.polynomial.hermite_e.hermegauss(12)
    sizes = "/".join(repr(float(std * node / math.sqrt(dt))) for node in nodes)
    source = """
    def shove(bird, size):
        return bird.mass * size
    """
    term = f"shove:size={sizes}"
    flock = with_law(tmp_path, source, term, birds=1, dt=dt, t_max=dt, record_every=1)
    mean = float(speeds(flock)[1] @ weights / weights.sum())
    scales = Scales.of(flock)
    u = scales.cruise_speed
    curvature = -scales.drag_coefficient_k * (2.0 + 6.0 / u**4) / scales.mass_ratio
    # The next terms are smaller by a dt and by f'''' std^2 dt / f'', both below 1e-3.
    assert mean - u == pytest.approx(curvature * std**2 * dt**2 / 6.0, rel=1e-3)
