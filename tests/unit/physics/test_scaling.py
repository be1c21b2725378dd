# SPDX-License-Identifier: Apache-2.0
"""Every formula of solo flight and scaling against an independent evaluation."""

from dataclasses import replace
from math import log, pi

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import brentq, minimize_scalar

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.physics.scaling import (
    GRAVITY,
    BirdCoefficients,
    Scales,
    StandardBird,
    flapping_thrust,
)

EPS = 2.0**-52
# A formula of some ten multiplications, divisions and roots: each rounds by half an ulp.
FORMULA = 16 * EPS

GOOSE = FlockConfiguration()
BIRD = StandardBird(GOOSE)
SCALES = Scales.of(GOOSE)


def consistent() -> FlockConfiguration:
    """The goose with the least-drag speed that its own drag says, so that all formulas agree."""
    speed = BIRD.minimum_drag_speed
    return replace(GOOSE, min_drag_speed=speed, cruise_speed=speed * 18.5 / 18.0)


def sized(ratio: float) -> FlockConfiguration:
    """A bird scaled isometrically: all lengths by `ratio`, mass by its cube."""
    return replace(GOOSE, wing_span=GOOSE.wing_span * ratio, body_mass=GOOSE.body_mass * ratio**3)


def exponent(quantity, ratio=1.37):
    """The power of the semi-span with which `quantity` of a bird grows, measured."""
    return log(quantity(StandardBird(sized(ratio))) / quantity(BIRD)) / log(ratio)


def test_defaults_are_a_canada_goose():
    assert BIRD.semi_span == 0.75
    assert BIRD.weight == pytest.approx(3.8 * 9.80665, rel=FORMULA)
    assert (2.0 * BIRD.semi_span) ** 2 / BIRD.wing_area == pytest.approx(9.0, rel=FORMULA)


def test_defaults_reproduce_the_papers_speed_of_least_drag_to_a_thousandth():
    assert pytest.approx(18.0, rel=1e-3) == BIRD.minimum_drag_speed


def test_default_mass_ratio_and_cruise_speed_are_the_papers():
    # 3.8 / (1.225 * 0.75^3) = 7.3530...: the paper rounds to three decimals.
    assert pytest.approx(7.353, abs=5e-4) == SCALES.mass_ratio
    assert pytest.approx(18.5 / 18.0, rel=FORMULA) == SCALES.cruise_speed


def test_speed_of_least_drag_is_where_the_drag_is_least():
    # A minimum is flat: drag tells speeds apart to sqrt(eps) only.
    found = minimize_scalar(BIRD.drag, bounds=(5.0, 50.0), options={"xatol": 1e-9})
    assert found.x == pytest.approx(BIRD.minimum_drag_speed, rel=4 * EPS**0.5)
    assert found.fun == pytest.approx(BIRD.minimum_drag, rel=FORMULA)


def test_speed_of_least_drag_is_a_root_of_the_slope():
    # The slope's own terms, 2 k_pro U and -2 k_ind / U^3, by hand.
    speed = BIRD.minimum_drag_speed
    up = 2.0 * BIRD.profile_coefficient * speed
    down = 2.0 * BIRD.induced_coefficient / speed**3
    assert up == pytest.approx(down, rel=FORMULA)


def test_least_drag_and_its_speed_by_aspect_ratio_and_weight():
    # The right-hand sides of Eqs. (Umin), (Dmin).
    aspect, oswald, zero_lift = 9.0, 0.8, 0.025
    loading = BIRD.weight / (1.225 * 0.75**2)
    speed = (aspect / (4.0 * pi * oswald * zero_lift)) ** 0.25 * loading**0.5
    drag = (4.0 * zero_lift / (pi * oswald * aspect)) ** 0.5 * BIRD.weight
    assert pytest.approx(speed, rel=FORMULA) == BIRD.minimum_drag_speed
    assert pytest.approx(drag, rel=FORMULA) == BIRD.minimum_drag


def test_induced_drag_is_that_of_an_elliptic_wing_worse_by_the_oswald_efficiency():
    # D_ind = L^2 / (2 pi e rho b^2 U^2) is (C_L^2 / (pi e AR)) rho U^2 S / 2, the textbook's polar.
    speed = 21.0
    lift_coefficient = BIRD.weight / (0.5 * 1.225 * speed**2 * BIRD.wing_area)
    polar = 0.025 + lift_coefficient**2 / (pi * 0.8 * 9.0)
    drag = polar * 0.5 * 1.225 * speed**2 * BIRD.wing_area
    assert BIRD.drag(speed) == pytest.approx(drag, rel=FORMULA)


@pytest.mark.parametrize(
    ("quantity", "power"),
    [
        (lambda bird: bird.wing_area, 2.0),
        (lambda bird: bird.profile_coefficient, 2.0),
        (lambda bird: bird.induced_coefficient, 4.0),
        (lambda bird: bird.minimum_drag_speed, 0.5),
        (lambda bird: bird.minimum_drag, 3.0),
        (lambda bird: flapping_thrust(0.2, 1.225, bird.wing_area, 4.0, 0.5 * bird.semi_span), 4.0),
    ],
    ids=["S", "k_pro", "k_ind", "U_min", "D_min", "T"],
)
def test_isometric_birds_scale_as_the_paper_says(quantity, power):
    # log of a ratio with relative error 2 FORMULA, over log(1.37) = 0.31.
    assert exponent(quantity) == pytest.approx(power, abs=2 * FORMULA / log(1.37))


def test_thrust_of_a_flapping_cycle():
    # Wing-tip speed 2 pi f A = pi m/s squared, times C_T rho S.
    thrust = flapping_thrust(0.25, 1.2, 0.5, 2.0, 0.25)
    assert thrust == pytest.approx(0.25 * 1.2 * 0.5 * pi**2, rel=FORMULA)


def test_unit_of_force_is_least_drag_by_aspect_ratio():
    bird = StandardBird(consistent())
    force = 9.0 / (4.0 * 0.025) * bird.minimum_drag
    assert bird.unit_force == pytest.approx(force, rel=FORMULA)


def test_drag_coefficient_follows_from_profile_and_from_induced_drag():
    bird, scales = StandardBird(consistent()), Scales.of(consistent())
    area = 1.225 * 0.75**2
    from_profile = bird.profile_coefficient / area
    from_induced = bird.induced_coefficient / (area * bird.minimum_drag_speed**4)
    assert scales.drag_coefficient_k == pytest.approx(from_profile, rel=FORMULA)
    assert scales.drag_coefficient_k == pytest.approx(from_induced, rel=FORMULA)


def test_circulation_is_that_which_lifts_the_bird():
    # Kutta-Joukowski: L = 2 a rho Gamma U = W, with 2 a = (pi/4) 2 b, at U = U_min.
    bird, scales = StandardBird(consistent()), Scales.of(consistent())
    speed, span = bird.minimum_drag_speed, 2.0 * (pi / 4.0) * 0.75
    circulation = bird.weight / (span * 1.225 * speed)
    assert scales.circulation_min == pytest.approx(circulation / (0.75 * speed), rel=FORMULA)


def test_cruise_drag_is_the_solo_drag_at_cruising_speed():
    bird, scales = StandardBird(consistent()), Scales.of(consistent())
    drag = bird.drag(consistent().cruise_speed) / bird.unit_force
    assert scales.cruise_drag == pytest.approx(drag, rel=2 * FORMULA)
    assert scales.cruise_ratio == pytest.approx(
        bird.drag(consistent().cruise_speed) / bird.minimum_drag, rel=2 * FORMULA
    )


@pytest.mark.parametrize("ratio", [0.5, 1.0, 1.7])
def test_coefficients_of_a_bird_are_those_of_an_isometric_one_in_units_of_the_standard(ratio):
    standard = StandardBird(consistent())
    bird = StandardBird(replace(consistent(), wing_span=1.5 * ratio, body_mass=3.8 * ratio**3))
    own = BirdCoefficients.of(Scales.of(consistent()), np.array([ratio]))
    force, speed = standard.unit_force, standard.minimum_drag_speed
    # 4 b^4 and the like: some formulas' roundings on top of each other.
    assert own.mass[0] == pytest.approx(3.8 * ratio**3 / (1.225 * 0.75**3), rel=FORMULA)
    assert own.profile_drag[0] == pytest.approx(
        bird.profile_coefficient * speed**2 / force, rel=2 * FORMULA
    )
    assert own.induced_drag[0] == pytest.approx(
        bird.induced_coefficient / speed**2 / force, rel=2 * FORMULA
    )
    lift_circulation = bird.weight / (2.0 * (pi / 4.0) * bird.semi_span * 1.225 * speed)
    assert own.circulation[0] == pytest.approx(lift_circulation / (0.75 * speed), rel=2 * FORMULA)
    standard_thrust = standard.drag(consistent().cruise_speed)
    assert own.thrust[0] == pytest.approx(standard_thrust * ratio**4 / force, rel=2 * FORMULA)


def test_coefficients_are_kept_in_the_order_that_the_kernels_take():
    own = BirdCoefficients.of(SCALES, np.array([0.9, 1.1]))
    expected = [own.mass, own.thrust, own.profile_drag, own.induced_drag, own.circulation]
    np.testing.assert_array_equal(own.rows(), expected)


@given(ratio=st.floats(1.0, 3.0))
def test_solo_cruise_is_where_thrust_meets_drag_on_the_fast_branch(ratio):
    own = BirdCoefficients.of(SCALES, np.array([ratio]))
    slowest = ratio**0.5  # U_min,j: drag grows from here on, so the root is the fast branch's

    def surplus(speed):
        drag = own.profile_drag[0] * speed**2 + own.induced_drag[0] / speed**2
        return (own.thrust[0] - drag) / own.thrust[0]

    root = brentq(surplus, slowest, 10.0, xtol=1e-15, rtol=4 * EPS)
    # Relative error of the root: that of the surplus, some 8 eps, over the drag's relative slope
    # 2 (1 - 1/h^2)^(1/2), h = lambda H_0 >= 1.0015: 0.055 and more.
    assert float(SCALES.solo_cruise_speed(ratio)) == pytest.approx(root, rel=FORMULA / 0.05)


def test_the_standard_bird_cruises_at_the_papers_speed():
    assert float(SCALES.solo_cruise_speed(1.0)) == pytest.approx(18.5 / 18.0, rel=FORMULA / 0.05)


def test_too_small_a_bird_has_no_solo_cruise_speed():
    limit = 1.0 / SCALES.cruise_ratio
    speeds = SCALES.solo_cruise_speed(np.array([0.5, limit * 0.999, limit * 1.001, 1.0]))
    assert np.isnan(speeds).tolist() == [True, True, False, False]
    # Near its limit a bird cruises just above its speed of least drag, lambda^(1/2).
    assert speeds[2] > (limit * 1.001) ** 0.5


def test_gravity_is_the_standard_one():
    assert GRAVITY == 9.80665
