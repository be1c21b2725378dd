# SPDX-License-Identifier: Apache-2.0
"""The steady state at a constant lag, against the balance of forces and against flights."""

import numpy as np
import pytest
from mpmath import mp
from scipy.optimize import root

from flock_sim.theory.delayed.nearest import BALANCED, delayed_nearest
from flock_sim.theory.equilibrium import equilibrium
from support.delayed_flights import DelayedFlight
from support.steady_flocks import (
    H_0,
    A,
    across,
    even,
    forces,
    integral,
    positions_of,
    random_ratios,
    saved,
    surplus,
)
from support.steady_states import flock_of, largest_force

# --- the balance of forces ---


@pytest.mark.parametrize("birds", [1, 2, 3, 4, 8, 13])
def test_without_a_lag_it_is_the_steady_state(birds):
    # U* and shares are known to some ten roundings a bird; a gap of up to 10 b answers to its share
    # by X / (2 s (1 - s)) of it.
    flock = flock_of(birds, random_ratios(seed=birds, birds=birds, members=500, spread=0.02))
    state, found = equilibrium(flock), delayed_nearest(flock, 0.0)
    firm = state.exists & (state.margin > 0.01)
    assert firm.sum() > 50
    np.testing.assert_array_equal(found.exists[firm], True)
    clearly_none = state.margin < -1e-9
    np.testing.assert_array_equal(found.exists[clearly_none], False)
    rounding = birds * 1e-14
    np.testing.assert_allclose(found.speed[firm], state.speed[firm], rtol=rounding)
    np.testing.assert_allclose(
        found.tail_share[:, firm], state.share[:, firm], rtol=0, atol=10 * rounding
    )
    np.testing.assert_allclose(
        found.head_share[:, firm], 1.0 - state.share[:, firm], rtol=0, atol=10 * rounding
    )
    np.testing.assert_allclose(
        found.spacing[:, firm], state.spacing[:, firm], rtol=0, atol=5000 * rounding
    )


@pytest.mark.parametrize("lag", [0.03, 0.5, 4.0, 60.0])
@pytest.mark.parametrize("birds", [2, 3, 4, 9])
def test_nobody_is_pulled_forward_or_back_however_different_the_birds(birds, lag):
    # The state is rounded, the forces on it, in 30 digits, are not: they change by 10 at most for a
    # relative change of 1 in speed or gaps, and some ten operations a bird are rounded.
    spread = 0.1 / (birds * (1.0 + 5.0 * lag**2))  # the later, the less there is to keep up with
    ratios = random_ratios(seed=birds, birds=birds, members=3000, spread=spread)
    state = delayed_nearest(flock_of(birds, ratios, cruise_speed=25.0), lag)
    members = np.flatnonzero(state.exists)[:20]
    assert len(members) == 20
    h_0 = 0.5 * ((mp.mpf(25) / 18) ** 2 + (mp.mpf(18) / 25) ** 2)
    for member in members:
        state_of_member = state.spacing[:, member], state.speed[member], ratios[:, member]
        assert largest_force(*state_of_member, lag=lag, h_0=h_0) < 10 * 10 * birds * 2.0**-52


@pytest.mark.parametrize("lag", [2.0, 10.0])
def test_rounding_does_not_grow_along_a_chain_that_somebody_else_leads(lag):
    # Gaps of birds that differ by 2 % and more turn either way at such lags: what is rounded
    # shrinks towards who leads, and grows the other way, as (g + d)^3 / (g - d)^3 far apart.
    ratios = random_ratios(seed=1, birds=13, members=30, spread=0.02)
    ratios[0] += np.where(np.arange(30) % 2, 0.06, 0.0)
    state = delayed_nearest(flock_of(13, ratios), lag)
    members = np.flatnonzero(state.exists)
    assert len(members) > 20
    assert np.sum(state.spacing[0, members] < 0.0) > 5
    for member in members[:15]:
        state_of_member = state.spacing[:, member], state.speed[member], ratios[:, member]
        # What is left over, and gaps rounded to 1e-16 of the 100 b of the whole flock.
        assert largest_force(*state_of_member, lag=lag) < BALANCED + 1e-13


def ends_of_a_root_finder(column, lag, random, tries):
    """Yield where a root finder ends from gaps and speeds at random, if forces balance there."""

    def balance(unknown):
        speeds = [unknown[0]] * len(column)
        return forces(positions_of(unknown[1:]).tolist(), speeds, column, lag=lag, of=np)

    for _ in range(tries):
        start = [random.uniform(1.05, 1.3), *random.uniform(-1.5, 1.5, len(column) - 1)]
        with np.errstate(all="ignore"):
            end = root(balance, start, tol=1e-13)
        if np.max(np.abs(balance(end.x))) < 1e-12:
            yield end.x


@pytest.mark.parametrize("birds", [2, 3, 4, 5])
def test_a_root_finder_finds_this_state_and_no_other(birds):
    # Forces of order 1, rounded to 1e-16, answer to gaps by 1e-4 or more of their change.
    random = np.random.default_rng(birds)
    ratios = random_ratios(seed=birds, birds=birds, members=100, spread=0.01)
    lag = 0.7
    state = delayed_nearest(flock_of(birds, ratios), lag)
    found = 0
    for member in np.flatnonzero(state.margin > 0.01)[:6]:
        for end in ends_of_a_root_finder(ratios[:, member].tolist(), lag, random, 8):
            if end[0] > 1.02:
                found += 1
                expected = [state.speed[member], *state.spacing[:, member]]
                np.testing.assert_allclose(end, expected, rtol=0, atol=1e-8)
    assert found > 10


def test_where_there_is_none_a_root_finder_finds_none():
    birds, lag = 4, 0.7
    ratios = random_ratios(seed=1, birds=birds, members=200, spread=0.05)
    state = delayed_nearest(flock_of(birds, ratios), lag)
    random = np.random.default_rng(2)
    without = np.flatnonzero(state.margin < -0.01)[:8]
    assert len(without) == 8
    for member in without:
        column = ratios[:, member].tolist()
        for end in ends_of_a_root_finder(column, lag, random, 4):
            assert end[0] ** 2 < H_0 * max(column) ** 2


def test_shares_are_what_birds_get_of_what_their_pair_would_save_without_a_lag():
    ratios = random_ratios(seed=3, birds=6, members=200, spread=0.01)
    lag = 0.4
    state = delayed_nearest(flock_of(6, ratios), lag)
    assert state.exists.sum() > 20
    for member in np.flatnonzero(state.exists):
        column, late = ratios[:, member].tolist(), lag * state.speed[member]
        side = across(column)
        for gap, x in enumerate(state.spacing[:, member]):
            pair = (side[gap + 1] - side[gap], A * column[gap], A * column[gap + 1])
            for share, seen in ((state.tail_share, x - late), (state.head_share, -x - late)):
                expected = integral(seen, *pair) / (2.0 * even(*pair))
                assert share[gap, member] == pytest.approx(expected, abs=1e-13)
    both = (state.tail_share + state.head_share)[:, state.exists]
    assert np.all((both > 0.0) & (both < 1.0))


# --- birds that are all alike ---


@pytest.mark.parametrize("birds", [2, 3, 4, 7, 13, 31])
def test_equals_fly_in_formation_at_any_lag_the_slower_the_later(birds):
    lags = np.geomspace(1e-3, 1e4, 100)
    state = delayed_nearest(flock_of(birds, np.ones((birds, 100))), lags)
    assert state.exists.all()
    assert np.all(np.diff(state.speed) < 0.0)
    # What each needs is r of a pair's saving, and nobody gets more of any pair. U^2 is rounded to
    # 2e-16 and r to 2 / (s |E|), 4, times that and a few roundings more.
    pair = saved(1.0 + A, 1.0, 1.0, state.speed)
    needed = surplus(1.0, state.speed) / pair
    assert np.all(state.tail_share <= needed + 1e-14)
    # At the last a bird gets s = 2 a^2 / (|E| d^2) < 1e-8 of |C| / k = 0.5, and R / k falls by 0.2
    # or more for a speed of 1.
    assert 0.0 < state.speed[-1] - 18.5 / 18.0 < 2.5e-8


def test_two_fly_side_by_side_at_any_lag():
    lags = np.array([0.0, 0.1, 1.0, 10.0, 1e3])
    state = delayed_nearest(flock_of(2, np.ones((2, 5))), lags)
    # Shares are rounded as U^2 is, to 1e-15: far out, where they are s = a^2 / (|E| X^2), a
    # distance X = U* tau by X / (2 s) times as much.
    late = lags * state.speed
    assert np.all(np.abs(state.spacing[0]) <= 5e-15 * (1.0 + late**3))


def test_three_that_see_each_other_very_late_fly_in_a_v_as_long_as_that():
    # s(X) -> a^2 / (|E| X^2) far ahead: 1 / (d - g)^2 = 2 / (d + g)^2, so g = (sqrt(2) - 1)^2 d,
    # and the next terms are (y / d)^2 of that.
    state = delayed_nearest(flock_of(3), 1000.0)
    late = 1000.0 * state.speed
    assert state.spacing[0] / late == pytest.approx((np.sqrt(2.0) - 1.0) ** 2, abs=1e-5)


@pytest.mark.parametrize("birds", [3, 4, 7])
def test_a_mirrored_flock_has_the_mirrored_state(birds):
    ratios = random_ratios(seed=birds, birds=birds, members=200, spread=0.01)
    one, other = (delayed_nearest(flock_of(birds, r), 0.8) for r in (ratios, ratios[::-1]))
    firm = (one.margin > 0.01) & (other.margin > 0.01)
    assert firm.sum() > 20
    np.testing.assert_allclose(other.speed[firm], one.speed[firm], rtol=1e-13)
    np.testing.assert_allclose(
        other.spacing[:, firm], -one.spacing[::-1, firm], rtol=0, atol=birds * 1e-11
    )
    np.testing.assert_allclose(
        other.head_share[:, firm], one.tail_share[::-1, firm], rtol=0, atol=birds * 1e-12
    )


def largest_ratio(bird, lag):
    """The largest span ratio of one bird of 13 with which the flock exists, to 1e-9."""
    inside, outside = 1.0, 1.2
    while outside - inside > 1e-9:
        middle = 0.5 * (inside + outside)
        ratios = np.ones((13, 1))
        ratios[bird - 1] = middle
        if delayed_nearest(flock_of(13, ratios), lag).exists[0]:
            inside = middle
        else:
            outside = middle
    return inside


def test_a_lag_lets_one_bird_be_larger():
    # Without a lag 1.0747; late enough the larger bird gets nothing, and has the ratio that alone
    # flies at U_c, at which a standard bird is just kept by the full wake of its equal,
    # u_c = H_0 + sqrt(H_0^2 - 1 - s E).
    limits = [largest_ratio(4, lag) for lag in (0.0, 0.1, 1.0, 30.0)]
    assert np.all(np.diff(limits) > 0.0)
    assert limits[0] == pytest.approx(1.0747244879, abs=2e-9)
    square = H_0 + np.sqrt(H_0**2 - 1.0 - saved(1.0 + A, 1.0, 1.0, 1.0))
    alone = np.sqrt(square**2 / (2.0 * H_0 * square - 1.0))
    assert alone == pytest.approx(1.0958, abs=1e-4)
    assert 0.0 < alone - limits[-1] < 1e-4


# --- flights ---


@pytest.mark.parametrize("lag", [0.5, 5.0])
def test_flights_of_birds_that_see_each_other_late_end_in_this_state(lag):
    # Where a flight ends doesn't depend on the birds' mass, on how fast it does: light birds don't
    # swing, and are e^-25 of their start away from it. The steady state is none of RK4's errors.
    ratios = np.column_stack([np.ones(3), [0.999, 1.001, 1.003]])
    state = delayed_nearest(flock_of(3, ratios), lag)
    assert state.exists.all()
    start = equilibrium(flock_of(3)).spacing[:, 0]
    position = np.repeat(positions_of(start)[:, np.newaxis], 2, axis=1)
    flight = DelayedFlight(
        ratios, position, np.full((3, 2), 1.2), np.full(2, lag), "hold", 1, mass=0.05
    )
    flight.advance(int(8000 / lag) if lag > 1.0 else 3000)
    np.testing.assert_allclose(
        flight.speed, np.broadcast_to(state.speed, (3, 2)), rtol=0, atol=1e-9
    )
    np.testing.assert_allclose(np.diff(flight.position, axis=0), state.spacing, rtol=0, atol=1e-7)
    # Without the lag they are elsewhere.
    assert np.all(np.abs(state.spacing - equilibrium(flock_of(3, ratios)).spacing) > 1e-3)


# --- members and bad input ---


def test_members_are_independent():
    ratios = random_ratios(seed=4, birds=5, members=20, spread=0.02)
    lags = np.linspace(0.0, 3.0, 20)
    together = delayed_nearest(flock_of(5, ratios), lags)
    for member in (0, 7, 19):
        alone = delayed_nearest(flock_of(5, ratios[:, [member]]), lags[member])
        assert alone.speed.tobytes() == together.speed[[member]].tobytes()
        assert alone.spacing.tobytes() == together.spacing[:, [member]].tobytes()


def test_without_a_state_there_are_no_numbers():
    ratios = np.ones((5, 2))
    ratios[1, 1] = 0.6
    state = delayed_nearest(flock_of(5, ratios), 1.0)
    assert state.exists.tolist() == [True, False]
    assert np.isnan(state.speed[1])
    assert np.isnan(state.spacing[:, 1]).all()
    assert not state.margin[1] > 0.0


@pytest.mark.parametrize("lag", [-1.0, np.nan, np.inf])
def test_a_lag_is_a_time(lag):
    with pytest.raises(ValueError, match="lag"):
        delayed_nearest(flock_of(3), lag)


def test_all_to_all_coupling_makes_no_chain():
    with pytest.raises(ValueError, match="chain"):
        delayed_nearest(flock_of(3, coupling="all"), 1.0)
