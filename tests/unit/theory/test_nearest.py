# SPDX-License-Identifier: Apache-2.0
"""The exact steady state of nearest-neighbour coupling, against the balance of forces."""

from math import nan

import mpmath
import numpy as np
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st
from mpmath import mp

from flock_sim.theory import nearest
from flock_sim.theory.equilibrium import nearest_shares
from support.steady_flocks import A, across, even, integral, random_ratios
from support.steady_states import flock_of, largest_force, steady

STANDARD = (1.0 + A, A, A)  # y, a, a' of two standard neighbours


# --- the balance of forces ---


@pytest.mark.parametrize("birds", [2, 3, 5, 9])
def test_nobody_is_pulled_forward_or_back_however_different_the_birds(birds):
    # The state is rounded, the forces on it, in 30 digits, are not. A relative change of 1 in speed
    # or gaps changes them by 10 at most, thrust and drag being 2 lambda^4; each share passes its
    # rounding, some ten operations, on along the chain.
    cruise = 25.0
    ratios = random_ratios(seed=birds, birds=birds, members=20000, spread=0.3 / birds)
    state = steady(birds, ratios, cruise_speed=cruise)
    members = np.flatnonzero(state.exists)[:40]
    assert len(members) == 40
    h_0 = 0.5 * ((mp.mpf(cruise) / 18) ** 2 + (18 / mp.mpf(cruise)) ** 2)
    for member in members:
        state_of_member = state.spacing[:, member], state.speed[member], ratios[:, member]
        assert largest_force(*state_of_member, h_0=h_0) < 10 * 10 * birds * 2.0**-52


@pytest.mark.parametrize("birds", [2, 3, 4, 7, 12, 13, 31])
def test_shares_of_standard_birds_fall_linearly(birds):
    # Eq. (linear_general_x), D_{i+1,i} = C (1 - i / N). One rounding a bird is carried along.
    state = steady(birds)
    expected = 1.0 - np.arange(1, birds) / birds
    np.testing.assert_allclose(state.share[:, 0], expected, rtol=0, atol=birds * 1e-15)


def test_share_is_what_the_birds_before_the_gap_get_of_what_its_pair_saves():
    ratios = random_ratios(seed=3, birds=6, members=300, spread=0.02)
    state = steady(6, ratios)
    for member in np.flatnonzero(state.exists):
        column = ratios[:, member]
        side = across(column.tolist())
        for gap, (x, share) in enumerate(zip(state.spacing[:, member], state.share[:, member])):
            pair = (side[gap + 1] - side[gap], A * column[gap], A * column[gap + 1])
            assert integral(x, *pair) / (2.0 * even(*pair)) == pytest.approx(share, abs=1e-14)


# --- what a steady formation depends on ---

SAME = 1e-12
"""What changes of parameters leave of spacings below 10 b that don't depend on them.

Constants differ by a few roundings, 1e-15; a share s by as much over each bird passed on from;
a gap X by X / (2 s (1 - s)) times that at most, as f goes as 1 / X^2 far out.
"""


def test_speed_depends_on_what_is_saved():
    assert steady(13, oswald_efficiency=0.9).speed > steady(13).speed + 0.01


@pytest.mark.parametrize("other", [{"zero_lift_drag": 0.01}, {"aspect_ratio": 5.0}], ids=str)
def test_a_flock_of_any_birds_depends_on_neither_drag_coefficient_nor_aspect_ratio(other):
    ratios = random_ratios(seed=5, birds=7, members=500, spread=0.02)
    one, two = steady(7, ratios), steady(7, ratios, **other)
    np.testing.assert_array_equal(one.exists, two.exists)
    firm = one.margin > 0.02
    assert firm.sum() > 100
    np.testing.assert_allclose(two.speed[firm], one.speed[firm], rtol=0, atol=SAME)
    np.testing.assert_allclose(two.spacing[:, firm], one.spacing[:, firm], rtol=0, atol=SAME / 0.02)


def test_a_flock_of_differing_birds_does_depend_on_the_oswald_efficiency():
    ratios = random_ratios(seed=5, birds=7, members=50, spread=0.01)
    one, two = steady(7, ratios), steady(7, ratios, oswald_efficiency=0.85)
    both = one.exists & two.exists
    assert both.sum() > 20
    assert np.all(np.abs(two.spacing - one.spacing)[:, both].max(axis=0) > 1e-3)


# --- a gap from its share ---

least = st.floats(-12.0, -0.31).map(lambda power: 10.0**power)
shares = st.one_of(st.floats(0.01, 0.99), least, least.map(lambda share: 1.0 - share))


@st.composite
def neighbours(draw):
    """(y, a, a') of neighbours."""
    one, other = draw(st.floats(0.1, 2.0)), draw(st.floats(0.1, 2.0))
    assume(one + other > 1.001)
    return one + other + A - 1.0, A * one, A * other


@given(share=shares, pair=neighbours())
@example(share=1e-12, pair=STANDARD)
@example(share=1.0 - 1e-12, pair=STANDARD)
@example(share=0.5, pair=STANDARD)
@example(share=0.5 + 2.0**-52, pair=STANDARD)
@example(share=0.5 - 2.0**-53, pair=STANDARD)
def test_a_gap_gives_the_share_that_it_was_made_from(share, pair):
    x = nearest.gap_of_share(share, *pair)
    with mpmath.workdps(40):
        y, a, b = (mp.mpf(value) for value in pair)
        # Far out what a bird ahead gets, f = I(-|x|), goes as 1 / x^2: the rounding of x counts
        # twice. f itself is promised to 1e-13, and so is E.
        ahead = integral(-abs(mp.mpf(x)), y, a, b, mp) / (2 * even(y, a, b, mp))
        smaller = min(mp.mpf(share), 1 - mp.mpf(share))
        assert abs(ahead - smaller) < mp.mpf("1e-13") * smaller
    assert x == 0.0 if share == 0.5 else (x > 0.0) == (share > 0.5)


@pytest.mark.parametrize("share", [0.0, 1.0, -1e-12, 1.0 + 1e-12, nan, -1e9, 1e9])
def test_no_gap_gives_a_share_that_is_not_between_0_and_1(share):
    assert np.isnan(nearest.gap_of_share(share, *STANDARD))


def test_swapping_the_birds_of_a_gap_turns_it_round():
    y, a, b = 2.0 + A - 1.0, 0.9 * A, 1.1 * A
    for share in (0.6, 0.75, 0.984375):  # 1 - share is exact
        assert nearest.gap_of_share(share, y, a, b) == -nearest.gap_of_share(1.0 - share, y, b, a)


# --- existence ---


def test_there_are_gaps_exactly_where_all_shares_are_between_0_and_1():
    ratios = random_ratios(seed=9, birds=9, members=2000, spread=0.02)
    state = steady(9, ratios)
    inside = np.all((state.share > 0.0) & (state.share < 1.0), axis=0)
    assert 100 < inside.sum() < 1900
    np.testing.assert_array_equal(state.exists, inside)
    np.testing.assert_array_equal(np.isfinite(state.spacing).all(axis=0), inside)
    np.testing.assert_array_equal(np.isnan(state.spacing).all(axis=0), ~inside)
    np.testing.assert_array_equal(np.isfinite(state.speed), inside)


def test_shares_tell_of_the_same_sum_from_either_end():
    # What birds 1..i get beyond what they need from one another is what i+1..N give: the last
    # share, 1 - (R_N / C_{N-1}), closes the sum. One rounding a bird.
    ratios = random_ratios(seed=2, birds=13, members=100, spread=0.05)
    flock = flock_of(13, ratios)
    square, share = nearest_shares(flock)
    last, before = ratios[-1], ratios[-2]
    h_0 = flock.scales.cruise_ratio
    needed = 2.0 * h_0 * last**4 - last**2 * square - last**4 / square
    pair = flock.scales.saving_ratio * (last * before) ** 2 * flock.even[-1] / square
    np.testing.assert_allclose(1.0 - share[-1], needed / pair, rtol=0, atol=1e-12)
