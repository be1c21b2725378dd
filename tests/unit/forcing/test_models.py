# SPDX-License-Identifier: Apache-2.0
"""The built-in forces against their formulas, and flights with them against closed forms."""

from __future__ import annotations

import math

import mpmath
import numpy as np
import pytest

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.forcing.law import Bird, Neighbours
from flock_sim.forcing.models import coloured_gust, constant, keeper, sine, white_gust
from flock_sim.forcing.registry import BUILT_IN
from flock_sim.forcing.settings import read
from flock_sim.physics.flock import Flock
from flock_sim.physics.scaling import Scales
from flock_sim.reference.integrator import Reference
from flock_sim.theory.equilibrium import equilibrium

LEADER = 3


def bird(number: int = 1, position: float = 2.0, speed: float = 1.1, mass: float = 7.0) -> Bird:
    return Bird(number, LEADER, 1.0, mass, 0.01, position, speed, 0.2)


def others(*known: tuple[int, float, float, float]) -> Neighbours:
    """Return neighbours of (number, position, speed, circulation)."""
    number, position, speed, circulation = zip(*known, strict=True)
    return Neighbours(
        np.array(number), np.zeros(len(known)), *map(np.array, (position, speed, circulation))
    )


def end(flock: FlockConfiguration) -> Reference:
    flight = Reference(flock)
    flight.advance(flock.steps)
    return flight


def test_a_constant_force_is_its_value() -> None:
    assert constant(0.25) == 0.25


@pytest.mark.parametrize("time", [0.0, 0.1, 12.5, 1e3, 1e7])
def test_a_sine_begins_with_its_phase_and_has_its_period(time: float) -> None:
    with mpmath.workdps(40):
        turns = mpmath.mpf(time) / mpmath.mpf(40.0) + mpmath.mpf(0.125)
        expected = 3.0 * mpmath.sin(2.0 * mpmath.pi * turns)
    # The argument is rounded to a double: its error is that of `turns`, times 2 pi.
    error = 3.0 * (2.0 * math.pi * 2.0**-52 * abs(float(turns)) + 2.0**-51)
    assert sine(time, 3.0, 40.0, 0.125) == pytest.approx(float(expected), rel=0, abs=error)
    assert sine(0.0, 3.0, 40.0, 0.25) == 3.0
    assert sine(20.0, 3.0, 40.0, 0.25) == -3.0
    assert sine(40.0, 3.0, 40.0, 0.5) == 0.0


@pytest.mark.parametrize(
    ("number", "neighbours", "force"),
    [
        # 0.5 (x_2 - x - gap) + 3 (U_2 - U)
        (1, others((2, 4.0, 1.3, 0.2)), 0.5 * (4.0 - 2.0 - 0.8) + 3.0 * (1.3 - 1.1)),
        (5, others((4, 4.0, 1.3, 0.2)), 0.5 * (4.0 - 2.0 - 0.8) + 3.0 * (1.3 - 1.1)),
        # the neighbour towards the leader counts, and the other one does not
        (2, others((1, 9.0, 9.0, 0.2), (3, 2.5, 1.0, 0.2)), 0.5 * (-0.3) + 3.0 * (-0.1)),
        (4, others((3, 2.5, 1.0, 0.2), (5, 9.0, 9.0, 0.2)), 0.5 * (-0.3) + 3.0 * (-0.1)),
        # the leader, a bird that knows nothing of this neighbour, and one without this neighbour
        (3, others((2, 4.0, 1.3, 0.2), (4, 4.0, 1.3, 0.2)), 0.0),
        (1, others((2, 4.0, 1.3, 0.0)), 0.0),
        (1, others((5, 4.0, 1.3, 0.2)), 0.0),
    ],
)
def test_a_keeper_pulls_towards_its_gap_and_the_speed_of_its_neighbour(
    number: int, neighbours: Neighbours, force: float
) -> None:
    found = keeper(bird(number), neighbours, 0.8, 0.5, 3.0)
    assert found == pytest.approx(force, rel=1e-14, abs=1e-15)


def test_the_damping_of_a_keeper_is_critical_unless_it_is_given() -> None:
    mass = np.array([4.0, 9.0])
    values = read("keeper:gap=1,stiffness=0.25/1").values(2)
    prepared = BUILT_IN["keeper"].prepare(values, 1.0, mass)
    # A bird behind one at constant speed: m z'' + damping z' + stiffness z = 0.
    assert prepared.parameters["damping"].tolist() == [2.0 * 1.0, 2.0 * 3.0]
    values = read("keeper:gap=1,stiffness=0.25,damping=0/7").values(2)
    given = BUILT_IN["keeper"].prepare(values, 1.0, mass).parameters["damping"]
    assert given.tolist() == [0.0, 7.0]


def test_a_white_gust_gives_a_bird_std_sqrt_dt_xi_in_a_step() -> None:
    prepared = BUILT_IN["gust"].prepare(read("gust:std=0.5").values(1), 0.25, np.array([7.0]))
    (scale,) = prepared.parameters["scale"]
    assert prepared.spread is None
    force = white_gust(bird(mass=7.0), np.array([2.0, 9.0]), scale)
    assert force / 7.0 * 0.25 == pytest.approx(0.5 * math.sqrt(0.25) * 2.0, rel=1e-15)


def test_a_coloured_gust_is_its_mean_over_the_step_times_the_mass() -> None:
    prepared = BUILT_IN["gust"].prepare(read("gust:std=0.5,time=4").values(1), 1.0, np.array([7.0]))
    assert prepared.spread is not None
    assert prepared.spread.tolist() == [0.5]
    c = [float(values[0]) for values in prepared.parameters.values()]
    force, (rate,) = coloured_gust(bird(mass=7.0), np.array([0.3]), np.array([2.0, -1.0]), *c)
    assert rate == pytest.approx(c[0] * 0.3 + c[1] * 2.0, rel=1e-15)
    assert force == pytest.approx(7.0 * (c[2] * 0.3 + c[3] * 2.0 - c[4]), rel=1e-14)


def test_a_constant_force_is_as_much_thrust() -> None:
    """The bird settles where T + F = k (U^2 + U^-2): a quadratic equation in U^2."""
    force = 1e-3
    flock = FlockConfiguration(birds=1, dt=50.0, t_max=4e5, forcing=(f"constant:force={force}/0",))
    scales = Scales.of(flock)
    sum_of_squares = (scales.cruise_drag + force) / scales.drag_coefficient_k
    square = 0.5 * (sum_of_squares + math.sqrt(sum_of_squares**2 - 4.0))
    speed = end(flock).speed[0]
    assert speed.tolist() == pytest.approx([math.sqrt(square), scales.cruise_speed], rel=1e-13)


def test_single_birds_and_members_have_their_own_force() -> None:
    flock = FlockConfiguration(
        birds=3,
        coupling="nearest",
        t_max=10.0,
        forcing=("2=constant:force=0/1e-3", "constant:force=1e-3/0"),
    )
    plain = end(FlockConfiguration(birds=3, t_max=10.0, forcing=("constant:force=1e-3",)))
    single = end(FlockConfiguration(birds=3, t_max=10.0, forcing=("2=constant:force=1e-3",)))
    flown = end(flock)
    np.testing.assert_array_equal(flown.speed[:, :1], plain.speed)
    np.testing.assert_array_equal(flown.speed[:, 1:], single.speed)


def test_terms_add_up_in_their_order() -> None:
    entries = ("constant:force=0.1", "constant:force=0.2", "constant:force=-0.3")
    flown = end(FlockConfiguration(birds=1, t_max=5.0, forcing=entries))
    total = (0.0 + 0.1 + 0.2) - 0.3  # not 0: the order is part of the result
    assert total != 0.0
    one = end(FlockConfiguration(birds=1, t_max=5.0, forcing=(f"constant:force={total!r}",)))
    np.testing.assert_array_equal(flown.speed, one.speed)


def test_no_force_changes_no_bit() -> None:
    flock = {"birds": 4, "t_max": 100.0, "coupling": "all", "span_ratios": ("2=0.9,1.1",)}
    nothing = ("constant:force=0", "keeper:gap=1,stiffness=0", "gust:std=0", "gust:std=0,time=3")
    plain = end(FlockConfiguration(**flock))
    forced = end(FlockConfiguration(**flock, forcing=nothing))
    assert plain.speed.tobytes() == forced.speed.tobytes()
    assert plain.position.tobytes() == forced.position.tobytes()


def test_a_sine_shakes_a_bird_as_its_linear_response_says() -> None:
    """Far above the damping rate the speed of a bird is amplitude / (m omega), a quarter late."""
    amplitude, period = 1e-5, 200.0
    flock = FlockConfiguration(
        birds=1,
        t_max=40 * period,
        record_every=1,
        forcing=(f"sine:amplitude={amplitude},period={period}",),
    )
    scales = Scales.of(flock)
    u0, omega = scales.cruise_speed, 2.0 * math.pi / period
    damping = 2.0 * scales.drag_coefficient_k * (u0 - u0**-3) / scales.mass_ratio
    speed = np.array([state.speed[0, 0] for state in Reference(flock).fly()])
    time = np.arange(len(speed))
    # u' = -damping u + F/m sin(omega t), u(0) = 0
    size = amplitude / scales.mass_ratio / (damping**2 + omega**2)
    expected = size * (
        damping * np.sin(omega * time)
        - omega * np.cos(omega * time)
        + omega * np.exp(-damping * time)
    )
    # Terms of second order: |u| / u0, here 1e-4; RK4: (omega dt)^4 / 120.
    np.testing.assert_allclose(speed - u0, expected, rtol=0, atol=1e-3 * size * omega)


def test_keepers_hold_the_gap_at_which_all_forces_balance() -> None:
    """Two birds in the steady state: the balance of each, and the sign of the force."""
    gap, stiffness = 1.5, 0.02
    free = float(equilibrium(Flock.of(FlockConfiguration(birds=2))).spacing[0, 0])
    flock = FlockConfiguration(
        birds=2, dt=2.0, t_max=2e5, forcing=(f"keeper:gap={gap},stiffness={stiffness}",)
    )
    flight = end(flock)
    (x1,), (x2,) = flight.position
    assert flight.speed[0, 0] == pytest.approx(flight.speed[1, 0], rel=1e-12)
    _, _, _, drag, _, _ = flight.observe()
    scales, u = Scales.of(flock), float(flight.speed[0, 0])
    own = scales.drag_coefficient_k * (u**2 + u**-2)
    pull = stiffness * (x2 - x1 - gap)
    rounding = 2.0 * stiffness * np.spacing(x2)  # of the gap
    assert scales.cruise_drag + pull - own - drag[0, 0] == pytest.approx(0.0, abs=rounding)
    assert scales.cruise_drag - own - drag[1, 0] == pytest.approx(0.0, abs=rounding)
    # Between the gap without a spring and the wanted one.
    assert min(abs(free), gap) < x2 - x1 < max(abs(free), gap)
