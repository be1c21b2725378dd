# SPDX-License-Identifier: Apache-2.0
"""Thrust limits against closed forms, and against bisection on independent steady states."""

from math import sqrt

import numpy as np
import pytest
from scipy.optimize import brentq

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.configuration.span_ratios import entries
from flock_sim.theory.equilibrium import equilibrium
from flock_sim.theory.span_limits import modified_birds
from flock_sim.theory.thrust_limits import exact_thrust_limits
from support.steady_flocks import (
    H_0,
    across,
    pair_of,
    pairs,
    random_ratios,
    saved,
    shares_of_all_sets,
    steady_speed,
)
from support.steady_states import flock_of, largest_force

LOW, HIGH = 0.0, 2.0

EXACT = 1e-10
"""The issue asks for 1e-9."""


def limits_of(birds, *, modified=None, low=LOW, high=HIGH, **parameters):
    configuration = FlockConfiguration(birds=birds, **parameters)
    return exact_thrust_limits(configuration, modified or modified_birds(configuration), low, high)


# --- closed forms, all birds of lambda = 1 ---


def speed_of_saving(saving):
    """The speed at which a standard bird needs to save `saving` / U^2, in units of k."""
    return sqrt(H_0 + sqrt(H_0**2 - 1.0 - saving))


def drag_ratio(speed):
    """D/D_0 of a standard bird."""
    return (speed**2 + speed**-2) / (2.0 * H_0)


@pytest.mark.parametrize("birds", [2, 3, 4, 5, 8, 13, 20, 31])
def test_upper_limit_is_one_value_for_all_birds_of_all_flocks(birds):
    # Its neighbours can just keep up with the bird in front of them: R = C. All pairs save C, and
    # the others need it all, so the bird flies as if alone, T = D.
    expected = drag_ratio(speed_of_saving(pair_of(1.0, 1.0, 1.0)))
    for limits in limits_of(birds):
        assert limits.upper.ratio == pytest.approx(expected, abs=EXACT)
        assert [limits.bird] == limits.upper.parts[0]


@pytest.mark.parametrize("birds", [2, 3, 4, 5, 8, 13, 20, 31])
def test_lower_limit_is_where_the_birds_ahead_fly_as_if_alone(birds):
    # (N - m) R = (N - m - 1) C of birds m + 1..N, and (m - 1) R + R_m = m C of the others.
    for limits in limits_of(birds):
        ahead = birds - limits.bird
        pair = pair_of(1.0, 1.0, 1.0)
        speed = speed_of_saving((1.0 - 1.0 / ahead) * pair)
        expected = 1.0 + limits.bird / ahead * pair / speed**2 / (2.0 * H_0)
        assert limits.lower.ratio == pytest.approx(expected, abs=EXACT)
        assert limits.bird in limits.lower.parts[-1]


@pytest.mark.parametrize("birds", [2, 3, 4, 5, 8, 13])
def test_upper_limit_all_to_all_is_one_value_for_all_birds_of_a_flock(birds):
    # The bird leaves all others, which need all that is saved: (N - 1) R = sum of all C.
    side = across([1.0] * birds)
    every = sum(saved(side[j] - side[i], 1.0, 1.0, 1.0) for i, j in pairs(birds, "all"))
    expected = drag_ratio(speed_of_saving(every / (birds - 1)))
    for limits in limits_of(birds, coupling="all"):
        assert limits.upper.ratio == pytest.approx(expected, abs=EXACT)
        others = [bird for bird in range(1, birds + 1) if bird != limits.bird]
        assert limits.upper.parts == [[limits.bird], others]


# --- flocks of any birds ---


def worst_share(ratios, coupling, thrusts):
    """The largest share of any set of birds, by all sets; of 1..i and i + 1..N where neighbours.

    It is inf where no speed balances the forces.
    """
    birds = len(ratios)
    try:
        speed = steady_speed(ratios, coupling, thrusts)
    except ValueError:
        return np.inf
    sets = shares_of_all_sets(ratios, speed, coupling, thrusts)
    rows = [tuple(range(gap)) for gap in range(1, birds)]
    rows += [tuple(range(gap, birds)) for gap in range(1, birds)]
    return max(sets[row] for row in (rows if coupling == "nearest" else sets))


def bisected(exists, inside, outside):
    """Where `exists` changes between two values, by bisection."""
    assert exists(inside)
    assert not exists(outside)
    while abs(outside - inside) > 1e-13:
        middle = 0.5 * (inside + outside)
        inside, outside = (middle, outside) if exists(middle) else (inside, middle)
    return 0.5 * (inside + outside)


@pytest.mark.parametrize("coupling", ["nearest", "all"])
@pytest.mark.parametrize("birds", [2, 3, 5, 6])
@pytest.mark.parametrize("seed", range(3))
def test_limits_of_any_flock_are_where_its_steady_state_ends(seed, birds, coupling):
    ratios = random_ratios(seed, birds, 1, 0.006)[:, 0].round(4).tolist()
    given = entries(np.array(ratios)[:, np.newaxis])
    found = limits_of(birds, modified=range(1, birds + 1), coupling=coupling, span_ratios=given)
    assert worst_share(ratios, coupling, [1.0] * birds) < 1.0
    for limits in found:

        def exists(thrust, bird=limits.bird):
            thrusts = [1.0] * birds
            thrusts[bird - 1] = thrust
            return worst_share(ratios, coupling, thrusts) < 1.0

        for end, outwards in ((limits.lower, -0.01), (limits.upper, 0.01)):
            expected = bisected(exists, 1.0, end.ratio + outwards)
            assert end.ratio == pytest.approx(expected, abs=EXACT)


@pytest.mark.parametrize("coupling", ["nearest", "all"])
def test_just_inside_of_a_limit_all_forces_balance(coupling):
    ratios = random_ratios(5, 5, 1, 0.006)[:, 0].round(4)
    given = entries(ratios[:, np.newaxis])
    flock = flock_of(5, ratios, coupling=coupling)
    for limits in limits_of(5, coupling=coupling, modified=range(1, 6), span_ratios=given):
        for end, inwards in ((limits.lower, 1e-4), (limits.upper, -1e-4)):
            thrusts = np.ones((5, 1))
            thrusts[limits.bird - 1] = end.ratio + inwards
            state = equilibrium(flock, thrusts)
            force = largest_force(
                state.spacing[:, 0],
                state.speed[0],
                ratios.tolist(),
                coupling,
                thrusts=thrusts[:, 0].tolist(),
            )
            assert force < 1e-12


# --- edges ---


def test_a_bird_alone_needs_the_thrust_of_least_drag():
    # H_0 T/T_0 >= 1, and no gap opens where it isn't.
    (found,) = limits_of(1)
    assert found.lower.ratio == pytest.approx(1.0 / H_0, abs=EXACT)
    assert found.lower.gap is None
    assert found.upper is None


def test_a_small_bird_between_large_ones_may_glide():
    found = limits_of(3, modified=[2], span_ratios=("2=0.2",))[0]
    assert found.lower is None
    assert found.searched[0] == 0.0
    ratios = [1.0, 0.2, 1.0]
    assert worst_share(ratios, "nearest", [1.0, 0.0, 1.0]) < 1.0
    state = equilibrium(flock_of(3, ratios), np.array([[1.0], [0.0], [1.0]]))
    spacing, speed = state.spacing[:, 0], state.speed[0]
    assert largest_force(spacing, speed, ratios, thrusts=[1.0, 0.0, 1.0]) < 1e-12


def test_a_limit_where_no_speed_balances_the_forces_has_no_gap():
    # Two birds of 0.88 fly near the speed of least drag.
    ratio = 0.88
    (found,) = limits_of(2, span_ratios=(f"1={ratio}", f"2={ratio}"))

    def radicand(thrust):
        half = H_0 * ratio**4 * (1.0 + thrust)
        return half**2 - 2.0 * ratio**2 * (2.0 * ratio**4 + pair_of(ratio, ratio, 1.0))

    expected = brentq(radicand, 0.1, 1.0, xtol=1e-15)
    assert found.lower.ratio == pytest.approx(expected, abs=EXACT)
    assert found.lower.gap is None
    assert found.lower.parts is None
    assert found.upper.gap == 1


@pytest.mark.parametrize("coupling", ["nearest", "all"])
def test_limits_of_the_other_wing_are_the_same(coupling):
    found = limits_of(5, modified=[1, 2, 3, 4, 5], coupling=coupling)
    for one, other in zip(found, reversed(found)):
        assert other.lower.ratio == pytest.approx(one.lower.ratio, abs=1e-12)
        assert other.upper.ratio == pytest.approx(one.upper.ratio, abs=1e-12)


def test_more_thrust_can_keep_a_flock_that_a_small_bird_breaks():
    small = ("1=0.97",)
    assert not equilibrium(flock_of(7, span_ratios=small)).exists[0]
    found = limits_of(7, modified=[1, 4], span_ratios=small)
    assert found[0].lower.ratio > 1.0
    assert not found[0].never
    assert found[0].lower.gap == 1


def test_a_flock_that_no_thrust_of_a_bird_keeps_is_never_kept():
    (found,) = limits_of(7, modified=[7], span_ratios=("2=0.6",))
    assert (found.never, found.lower, found.upper) == (True, None, None)


def test_ends_outside_of_what_is_searched_are_none():
    for limits in limits_of(7, low=0.96, high=1.1):
        assert limits.upper is None
        assert (limits.lower is None) == (limits.bird > 1)
        assert limits.searched == (0.96, 1.1)
