# SPDX-License-Identifier: Apache-2.0
"""The equation of motion of one bird, and the forces of a pair as each of both computes them."""

from math import pi

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from flock_sim.physics.aerodynamics import even_part, interaction_integral
from flock_sim.physics.dynamics import acceleration, circulation_at, drag_of_pair

A = pi / 4.0
EPS = 2.0**-52

ratios = st.floats(0.3, 2.0)
circulations = st.floats(0.01, 1.0)
distances = st.floats(-1e6, 1e6) | st.floats(-3.0, 3.0) | st.just(0.0)


@st.composite
def pairs(draw):
    """Arguments of drag_of_pair but for x: y, a, a', E, Gamma, Gamma'."""
    one, other = draw(ratios), draw(ratios)
    assume(one + other > 1.001)
    lateral = one + other + A - 1.0
    even = even_part(lateral, A * one, A * other)
    return lateral, A * one, A * other, even, draw(circulations), draw(circulations)


@given(x=distances, pair=pairs())
def test_both_birds_compute_the_same_bits_for_the_pair(x, pair):
    # This is why the distributed flight equals the monolithic one.
    lateral, half, other_half, even, circulation, other_circulation = pair
    on_bird, on_other = drag_of_pair(x, *pair)
    seen = drag_of_pair(-x, lateral, other_half, half, even, other_circulation, circulation)
    assert seen == (on_other, on_bird)


@given(pair=pairs())
def test_side_by_side_both_feel_the_same_bits(pair):
    for zero in (0.0, -0.0):
        on_bird, on_other = drag_of_pair(zero, *pair)
        assert on_bird == on_other


@pytest.mark.parametrize("apart", range(1, 13))
def test_standard_birds_side_by_side_feel_the_same_bits_however_far_apart(apart):
    # 2 E - f(0) and f(0) are E both, but for rounding: which one is taken must not depend on whose
    # computation it is. At some of these distances the two differ in the last bit.
    lateral = apart * (1.0 + A)
    on_bird, on_other = drag_of_pair(0.0, lateral, A, A, even_part(lateral, A, A), 0.1, 0.1)
    assert on_bird == on_other


@given(x=distances, pair=pairs())
def test_drag_is_circulations_by_the_integral_of_source_minus_target(x, pair):
    lateral, half, other_half, _, circulation, other_circulation = pair
    on_bird, on_other = drag_of_pair(x, *pair)
    strength = circulation * other_circulation / (4.0 * pi)
    # The bird is the target: x is the other's position minus its own, D_ij of Eq. (Dij).
    felt = strength * float(interaction_integral(x, lateral, other_half, half))
    caused = strength * float(interaction_integral(-x, lateral, half, other_half))
    # Three products, each rounded, and 1 / (4 pi) rounded once more on the way.
    assert on_bird == pytest.approx(felt, rel=8 * EPS)
    assert on_other == pytest.approx(caused, rel=8 * EPS)


@given(x=st.floats(1e-3, 1e3), pair=pairs())
def test_the_bird_behind_saves_more(x, pair):
    on_bird, on_other = drag_of_pair(x, *pair)  # the other is ahead: the bird flies in its wake
    assert on_bird < on_other < 0.0


@given(speed=st.floats(0.1, 10.0), coefficient=st.floats(0.01, 1.0))
def test_slower_birds_have_more_circulation_so_that_lift_stays(speed, coefficient):
    lift = circulation_at(speed, coefficient) * speed
    assert lift == pytest.approx(coefficient, rel=EPS)


def test_acceleration_is_thrust_less_drags_over_mass():
    # (5 - (3 * 2^2 + 8 / 2^2) - 1) / 4 = -2.5, all exact in binary.
    assert acceleration(2.0, 1.0, 4.0, 5.0, 3.0, 8.0) == -2.5


def test_interaction_drag_slows_and_thrust_speeds_up():
    steady = acceleration(1.0, 0.0, 7.0, 0.02, 0.01, 0.01)
    assert steady == 0.0
    assert acceleration(1.0, 1e-3, 7.0, 0.02, 0.01, 0.01) < 0.0
    assert acceleration(1.0, 0.0, 7.0, 0.03, 0.01, 0.01) > 0.0


@pytest.mark.parametrize("x", [np.nan, np.inf, -np.inf])
def test_a_pair_that_diverged_raises_nothing(x):
    lateral = 1.0 + A
    drag_of_pair(x, lateral, A, A, even_part(lateral, A, A), 0.1, 0.1)
    assert circulation_at(0.0, 0.1) == np.inf
