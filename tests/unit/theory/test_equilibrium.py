# SPDX-License-Identifier: Apache-2.0
"""Steady states against flights to convergence, and edge cases."""

from itertools import pairwise
from math import inf, sqrt

import numpy as np
import pytest
from scipy.optimize import brentq, root

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.physics.flock import Flock
from flock_sim.reference.integrator import Reference
from flock_sim.theory.equilibrium import Equilibrium, equilibrium
from support.steady_flocks import (
    H_0,
    across,
    drag,
    forces,
    pair_of,
    pairs,
    positions_of,
    random_ratios,
    surplus,
)
from support.steady_states import steady

# --- the balance of forces ---


@pytest.mark.parametrize(
    ("coupling", "birds", "drawn", "least", "most"),
    [
        *(("nearest", birds, 4000, 10, 40) for birds in (2, 3, 4, 5, 8, 13, 21)),
        *(("all", birds, 60, 20, 20) for birds in (2, 3, 4, 5, 8)),
    ],
)
def test_state_is_the_one_that_a_root_finder_finds(coupling, birds, drawn, least, most):
    # Forces of order 1 are rounded to 1e-16 and answer to a gap of up to 8 b, or one that carries a
    # share of 0.99, by 1e-4 or more of its change, through a chain of N such: 1e-11 for the finder.
    # All-to-all alike: stiffnesses of 1e-4 and more, some N of them.
    ratios = random_ratios(seed=birds, birds=birds, members=drawn, spread=0.02)
    state = steady(birds, ratios, coupling=coupling)
    members = np.flatnonzero(state.margin > 0.01)[:most]
    assert len(members) >= least
    for member in members:
        column = ratios[:, member].tolist()

        def balance(unknown, column=column):
            places = positions_of(unknown[1:]).tolist()
            return forces(places, [unknown[0]] * birds, column, coupling)

        shape_of_v = [0.5 if gap < birds // 2 else -0.5 for gap in range(birds - 1)]
        found = root(balance, [1.1, *shape_of_v], tol=1e-14).x
        again = root(balance, found, tol=1e-15).x  # with a Jacobian taken at the end
        np.testing.assert_allclose(state.speed[member], again[0], rtol=0, atol=1e-10)
        np.testing.assert_allclose(state.spacing[:, member], again[1:], rtol=0, atol=1e-10)


# --- where flights end ---

LAST = 1000.0
"""Time of a flight, in b/U_min, that is flown near 0, after it was set back there.

1e5 b away positions are multiples of 2^-36 b, and so are the speeds of birds that keep their
distances at dt = 1: too coarse to tell speeds to 1e-11. Within 1e3 b they are multiples of 2^-43.
"""

LONG_STEP = 4.0
"""A step, in b/U_min, by which many flocks are flown. Steady flight is the same for every step,
since Runge-Kutta methods are exact where slopes are constant, and what fades does so in a hundred
times that.
"""


def settled(configuration, ratios) -> Reference:
    """Flocks after t = 1e5, in which all that is to fade does so by e^-40 and more."""
    flight = Reference(configuration, ratios)
    last = round(LAST / configuration.dt)
    flight.advance(configuration.steps - last)
    flight.position -= flight.position[0].copy()
    flight.advance(last)
    return flight


def assert_flown_to(state: Equilibrium, flight: Reference) -> None:
    # As issued: relative positions, birds' to one another, to 1e-8 and speeds to 1e-11.
    relative = np.concatenate([np.zeros((1, flight.flock.members)), state.spacing]).cumsum(axis=0)
    flown = flight.position - flight.position[0]
    np.testing.assert_allclose(flown, relative, rtol=0, atol=1e-8)
    np.testing.assert_allclose(
        flight.speed, np.broadcast_to(state.speed, flight.speed.shape), rtol=0, atol=1e-11
    )


def assert_random_flocks_fly_there(birds, flocks, spread, coupling="nearest"):
    configuration = FlockConfiguration(
        birds=birds, coupling=coupling, dt=LONG_STEP, t_max=1e5, record_every=100000
    )
    drawn = random_ratios(seed=birds, birds=birds, members=20 * flocks, spread=spread)
    state = equilibrium(Flock.of(configuration, drawn))
    ratios = np.ascontiguousarray(drawn[:, np.flatnonzero(state.margin > 0.05)[:flocks]])
    assert ratios.shape[1] == flocks
    state = equilibrium(Flock.of(configuration, ratios))
    assert_flown_to(state, settled(configuration, ratios))


@pytest.mark.parametrize("birds", [3, 4, 5, 8, 13, 20, 31])
def test_standard_birds_fly_to_their_steady_state(birds):
    configuration = FlockConfiguration(birds=birds, t_max=1e5, record_every=100000)
    flight = settled(configuration, configuration.span_ratio)
    assert_flown_to(equilibrium(flight.flock), flight)


@pytest.mark.parametrize("birds", [3, 7])
def test_standard_birds_fly_to_their_steady_state_all_to_all(birds):
    configuration = FlockConfiguration(birds=birds, coupling="all", t_max=1e5, record_every=100000)
    flight = settled(configuration, configuration.span_ratio)
    assert_flown_to(equilibrium(flight.flock), flight)


@pytest.mark.slow
def test_two_hundred_random_flocks_fly_to_their_steady_states():
    # Thirteen birds of 1 %: one flock in four has the margin, 1/13 being the most there is.
    assert_random_flocks_fly_there(birds=13, flocks=200, spread=0.01)


@pytest.mark.slow
def test_small_flocks_of_very_different_birds_fly_to_their_steady_states():
    assert_random_flocks_fly_there(birds=5, flocks=30, spread=0.04)


@pytest.mark.slow
def test_random_flocks_fly_to_their_steady_states_all_to_all():
    assert_random_flocks_fly_there(birds=5, flocks=20, spread=0.02, coupling="all")


# --- what a state tells ---


@pytest.mark.parametrize("coupling", ["nearest", "all"])
def test_drag_reduction_is_what_a_bird_saves_of_its_drag_at_cruise(coupling):
    # 1e-9: all-to-all states are found to 1e-12 of their size, their forces to less than 1e-11.
    ratios = random_ratios(seed=6, birds=5, members=30, spread=0.02)
    state = steady(5, ratios, coupling=coupling)
    assert state.exists.sum() > 10
    for member in np.flatnonzero(state.exists):
        column, speed = ratios[:, member].tolist(), float(state.speed[member])
        position, side = positions_of(state.spacing[:, member]), across(column)
        felt = np.zeros(5)
        for i, j in pairs(5, coupling):
            for one, other in ((i, j), (j, i)):
                felt[other] += drag(
                    position[one] - position[other],
                    side[one] - side[other],
                    column[one],
                    column[other],
                    (speed, speed),
                )
        np.testing.assert_allclose(
            state.drag_reduction[:, member], -felt / (2.0 * H_0), rtol=0, atol=1e-9
        )


def test_speed_is_the_higher_of_the_two_at_which_all_forces_balance():
    ratios = random_ratios(seed=8, birds=6, members=200, spread=0.02)
    state = steady(6, ratios)
    for member in np.flatnonzero(np.isfinite(state.balanced_speed)):
        column = ratios[:, member].tolist()

        def total(speed, column=column):
            saved = sum(pair_of(one, other, speed) for one, other in pairwise(column))
            return sum(surplus(ratio, speed) for ratio in column) - saved

        # T N - (a U^2 + b U^-2) has its top at (b / a)^(1/4) = 0.9 and falls beyond.
        found = brentq(total, 1.0, 3.0, xtol=1e-15, rtol=1e-15)
        assert state.balanced_speed[member] == pytest.approx(found, abs=1e-14)
        assert total(found - 1e-3) > 0.0 > total(found + 1e-3)
    np.testing.assert_array_equal(state.speed[state.exists], state.balanced_speed[state.exists])


@pytest.mark.parametrize("coupling", ["nearest", "all"])
def test_weakest_gap_is_the_one_whose_share_is_nearest_to_its_end(coupling):
    ratios = random_ratios(seed=8, birds=6, members=40, spread=0.02)
    state = steady(6, ratios, coupling=coupling)
    for member in range(40):
        room = [min(share, 1.0 - share) for share in state.share[:, member]]
        assert state.weakest_gap[member] == 1 + room.index(min(room))


@pytest.mark.parametrize("coupling", ["nearest", "all"])
@pytest.mark.parametrize("birds", [3, 4, 7, 8])
def test_of_equally_weak_gaps_the_first_is_named(birds, coupling):
    # The outermost gaps of a flock of equals, but for rounding, from either end.
    assert steady(birds, coupling=coupling).weakest_gap.tolist() == [1]


def test_margin_of_standard_birds_is_that_of_the_outermost():
    for birds in (2, 5, 12, 31):
        assert steady(birds).margin[0] == pytest.approx(1.0 / birds, abs=birds * 1e-15)


# --- what a steady formation depends on ---

OTHERS = [{"oswald_efficiency": 0.95}, {"zero_lift_drag": 0.01}, {"aspect_ratio": 5.0}]
MORE = [{"oswald_efficiency": 0.5}, {"cruise_speed": 25.0}]


@pytest.mark.parametrize(
    ("coupling", "birds", "tolerance", "others"),
    [
        # A gap X answers to its share s by X / (2 s (1 - s)) of it, as f goes as 1 / X^2 far out.
        *(("nearest", birds, 1e-12, [*OTHERS, *MORE]) for birds in (3, 4, 13)),
        # R_j is the same for all, and so sum C / N: forces are a common multiple.
        *(("all", birds, 1e-10, OTHERS) for birds in (3, 4, 9)),
    ],
)
def test_spacing_of_standard_birds_depends_on_none_of_the_drag_parameters(
    coupling, birds, tolerance, others
):
    one = steady(birds, coupling=coupling)
    for other in others:
        two = steady(birds, coupling=coupling, **other)
        np.testing.assert_allclose(two.spacing, one.spacing, rtol=0, atol=tolerance)


@pytest.mark.parametrize(
    ("coupling", "birds", "members", "spread", "most", "share", "gap"),
    [
        # Sums are taken from the other end: N roundings in a share.
        *(
            ("nearest", birds, 200, 0.01, 50, birds * 1e-14, birds * 1e-10)
            for birds in (2, 5, 8, 13)
        ),
        *(("all", birds, 60, 0.02, 20, 1e-12, 1e-10) for birds in (3, 6)),
    ],
)
def test_a_mirrored_flock_has_the_mirrored_state(
    coupling, birds, members, spread, most, share, gap
):
    ratios = random_ratios(seed=birds, birds=birds, members=members, spread=spread)
    one, other = (steady(birds, drawn, coupling=coupling) for drawn in (ratios, ratios[::-1]))
    np.testing.assert_array_equal(one.exists, other.exists)
    assert one.exists.sum() > most
    np.testing.assert_allclose(other.share, 1.0 - one.share[::-1], rtol=0, atol=share)
    np.testing.assert_allclose(other.speed, one.speed, rtol=1e-14)
    firm = one.margin > 0.01
    mirrored = -one.spacing[::-1]
    np.testing.assert_allclose(other.spacing[:, firm], mirrored[:, firm], rtol=0, atol=gap)
    saved = one.drag_reduction[::-1]
    np.testing.assert_allclose(
        other.drag_reduction, saved, atol=1e-13 if coupling == "nearest" else 1e-9
    )


# --- at the edges ---


@pytest.mark.parametrize("coupling", ["nearest", "all"])
def test_a_bird_alone_cruises_and_has_no_gap_to_lose(coupling):
    ratio = np.array([[1.0, 1.1]])
    state = steady(1, ratio, coupling=coupling)
    # lambda H_0 = (u + lambda^2 / u) / (2 lambda), Eq. (scaling).
    half = ratio[0] ** 2 * H_0
    expected = np.sqrt(half + np.sqrt(half**2 - ratio[0] ** 2))
    np.testing.assert_allclose(state.speed, expected, rtol=1e-14)
    assert state.exists.tolist() == [True, True]
    assert state.margin.tolist() == [inf, inf]
    assert state.weakest_gap.tolist() == [0, 0]
    assert state.spacing.shape == state.share.shape == (0, 2)
    # It saves nothing: what T - D of its speed leaves is rounding.
    np.testing.assert_allclose(state.drag_reduction, [[0.0, 0.0]], rtol=0, atol=1e-14)


def test_a_standard_bird_alone_flies_at_its_cruising_speed():
    assert steady(1).speed[0] == pytest.approx(18.5 / 18.0, abs=1e-15)


@pytest.mark.parametrize("coupling", ["nearest", "all"])
def test_two_equal_birds_fly_side_by_side(coupling):
    state = steady(2, coupling=coupling)
    assert state.exists[0]
    assert state.share[0, 0] == pytest.approx(0.5, abs=1e-15)
    assert abs(state.spacing[0, 0]) < 1e-14
    assert state.weakest_gap.tolist() == [1]
    expected = brentq(lambda u: 2.0 * surplus(1.0, u) - pair_of(1.0, 1.0, u), 1.0, 2.0, xtol=1e-15)
    assert state.speed[0] == pytest.approx(expected, abs=1e-14)


@pytest.mark.parametrize("coupling", ["nearest", "all"])
def test_the_larger_of_two_birds_leads(coupling):
    state = steady(2, coupling=coupling, span_ratios=("1=1.02,0.98",))
    assert state.exists.all()
    assert state.spacing[0, 0] < -0.01
    assert state.spacing[0, 1] > 0.01


@pytest.mark.parametrize("coupling", ["nearest", "all"])
def test_birds_too_small_for_any_speed_have_no_state(coupling):
    # A bird of lambda = 0.7 has T = 0.7^4 2 H_0 and a least drag of 2 0.7^3: it saves too little.
    ratios = np.ones((3, 2))
    ratios[:, 1] = 0.7
    state = steady(3, ratios, coupling=coupling)
    assert state.exists.tolist() == [True, False]
    assert np.isnan(state.speed[1])
    assert np.isnan(state.balanced_speed[1])
    assert not state.margin[1] > 0.0
    assert state.weakest_gap.tolist() == [1, 0]
    assert np.isnan(state.spacing[:, 1]).all()
    column = ratios[:, 1].tolist()
    for speed in np.linspace(0.2, 3.0, 300):
        total = sum(forces([0.0, 0.0, 0.0], [speed] * 3, column, coupling))
        assert total < 0.0


def test_a_bird_too_small_to_cruise_alone_has_no_state_alone():
    # It takes lambda H_0 >= 1, and H_0 is 1.0015.
    state = steady(1, np.array([[0.998, 0.999]]))
    assert state.exists.tolist() == [False, True]
    assert state.weakest_gap.tolist() == [0, 0]


@pytest.mark.parametrize(("coupling", "birds"), [("nearest", 13), ("all", 5)])
def test_what_is_solved_together_is_solved_as_if_alone(coupling, birds):
    ratios = random_ratios(seed=1, birds=birds, members=30, spread=0.02)
    ratios[:, 3] = 0.6  # no speed
    ratios[1, 4] = 0.55  # no formation
    together = steady(birds, ratios, coupling=coupling)
    assert 5 < together.exists.sum() < 30
    for member in range(30):
        alone = steady(birds, ratios[:, [member]], coupling=coupling)
        for name in ("exists", "speed", "balanced_speed", "margin", "weakest_gap"):
            one, other = getattr(together, name)[[member]], getattr(alone, name)
            assert one.tobytes() == other.tobytes(), name
        for name in ("spacing", "share", "drag_reduction"):
            one, other = getattr(together, name)[:, [member]], getattr(alone, name)
            assert one.tobytes() == other.tobytes(), name


def test_a_single_bird_can_be_carried_by_its_flock():
    # Too small to cruise alone, and yet there is a formation that has it.
    carried = steady(3, span_ratios=("2=0.99",))
    assert carried.exists[0]
    assert np.isnan(steady(1, span_ratios=("1=0.99",)).speed[0])
    assert carried.drag_reduction[1, 0] > carried.drag_reduction[0, 0]


def test_speed_in_the_limit_of_no_saving_is_that_of_a_bird_alone():
    # e_O -> 0: the saved part of drag goes with it.
    state = steady(7, oswald_efficiency=1e-9)
    assert state.exists[0]
    # dU/U = s E / (dR/dU) = 4e-10 * 1.5 / 0.4
    assert state.speed[0] == pytest.approx(18.5 / 18.0, abs=1e-8)


def test_a_flock_is_faster_than_a_bird_alone_by_what_it_saves():
    # N k (2 H_0 - u - 1/u) = (N - 1) s k E / u with equal birds: a quadratic in u = U^2.
    for birds in (2, 13, 31):
        per_bird = pair_of(1.0, 1.0, 1.0) * (birds - 1) / birds
        expected = sqrt(H_0 + sqrt(H_0**2 - 1.0 - per_bird))
        assert steady(birds).speed[0] == pytest.approx(expected, abs=1e-14)
