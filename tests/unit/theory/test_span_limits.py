# SPDX-License-Identifier: Apache-2.0
"""Stability limits against closed forms, and the search for them against artificial flocks."""

from math import sqrt

import numpy as np
import pytest
from scipy.optimize import brentq

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.configuration.span_ratios import entries
from flock_sim.theory.limit_search import NO_GAP, End
from flock_sim.theory.span_limits import exact_limits, modified_birds, search
from support.steady_flocks import (
    H_0,
    pair_of,
    random_ratios,
    shares_of_all_sets,
    steady_speed,
    surplus,
)

LOW, HIGH = 0.5, 2.0

EXACT = 1e-10
"""As issued. Shares are known to N roundings, 1e-14; lambda^4 makes little of that."""


def limits_of(birds, *, modified=None, low=LOW, high=HIGH, **parameters):
    configuration = FlockConfiguration(birds=birds, **parameters)
    return exact_limits(configuration, modified or modified_birds(configuration), low, high)


# --- closed forms, nearest neighbours, all others of lambda = 1 ---


def speed_of_share(share):
    """The speed at which a standard bird needs `share` of what a pair of such saves.

    R(U) = share C(U), that is 2 H_0 - u - 1 / u = share C(1) / u with u = U^2.
    """
    return sqrt(H_0 + sqrt(H_0**2 - 1.0 - share * pair_of(1.0, 1.0, 1.0)))


def needed(share):
    return share * pair_of(1.0, 1.0, speed_of_share(share))


def ratio_at(condition, low, high):
    return brentq(condition, low, high, xtol=1e-15, rtol=1e-15)


def lower_limit(birds, bird):
    """What keeps birds m + 1..N behind nobody: bird m has all that the pair across gap m saves.

    They fly as if alone, (N - m) R = (N - m - 1) C; birds 1..m have what their pairs save and that.
    """
    share = 1.0 - 1.0 / (birds - bird)
    speed = speed_of_share(share)

    def condition(ratio):
        modified = pair_of(1.0, ratio, speed)
        if bird == 1:
            return surplus(ratio, speed) - modified
        others = (bird - 1) * needed(share) - (bird - 2) * pair_of(1.0, 1.0, speed)
        return others + surplus(ratio, speed) - 2.0 * modified

    return ratio_at(condition, LOW, 1.0)


@pytest.mark.parametrize("birds", [2, 3, 4, 5, 8, 13, 20, 31])
def test_lower_limit_is_where_the_birds_ahead_fly_as_if_alone(birds):
    found = limits_of(birds)
    for limits in found:
        if (birds, limits.bird) == (3, 2):
            assert limits.lower is None
            continue
        assert limits.lower.ratio == pytest.approx(lower_limit(birds, limits.bird), abs=EXACT)


def test_a_leader_of_three_may_be_as_small_as_can_be_searched():
    # At a lower limit the two others would fly as if alone, at U_0, and the leader would have all
    # that both pairs save: with vortices this close that is more than even half a bird needs.
    assert limits_of(3)[1].lower is None
    speed = speed_of_share(0.0)
    assert speed == pytest.approx(18.5 / 18.0, abs=1e-15)
    assert surplus(0.5, speed) > 2.0 * pair_of(1.0, 0.5, speed)


@pytest.mark.parametrize("birds", [4, 5, 8, 13, 20])
def test_upper_limit_of_all_but_the_outermost_is_one_value(birds):
    # A standard bird is just kept by the full wake of its equal, R = C: all gaps between standard
    # birds are at their end. Then R_m + 2 C = 2 C', of the modified bird and its two pairs.
    speed = speed_of_share(1.0)
    expected = ratio_at(
        lambda ratio: (
            surplus(ratio, speed)
            + 2.0 * pair_of(1.0, 1.0, speed)
            - 2.0 * pair_of(1.0, ratio, speed)
        ),
        1.0,
        1.3,
    )
    for limits in limits_of(birds)[1:]:
        assert limits.upper.ratio == pytest.approx(expected, abs=EXACT)
        # What parts is no gap beside the modified bird.
        assert limits.upper.gap not in (limits.bird - 1, limits.bird)


@pytest.mark.parametrize("birds", [3, 4, 5, 8, 13, 20])
def test_upper_limit_of_the_outermost_is_one_value(birds):
    speed = speed_of_share(1.0)
    expected = ratio_at(
        lambda ratio: surplus(ratio, speed) + pair_of(1.0, 1.0, speed) - pair_of(1.0, ratio, speed),
        1.0,
        1.3,
    )
    limits = limits_of(birds)[0]
    assert limits.upper.ratio == pytest.approx(expected, abs=EXACT)
    assert limits.upper.gap == 2


def test_upper_limit_where_no_two_standard_birds_are_neighbours():
    # Of two birds, and of a leader of three: the modified one flies as if alone, R_m = 0, and the
    # standard ones need all that their pair with it saves, R = C'. One value, as u - 2 H_0 + 1 / u
    # knows of one neighbour only.
    def condition(ratio):
        half = ratio**2 * H_0
        speed = sqrt(half + sqrt(half**2 - ratio**2))
        return surplus(1.0, speed) - pair_of(1.0, ratio, speed)

    expected = ratio_at(condition, 1.001, 1.3)
    assert limits_of(2)[0].upper.ratio == pytest.approx(expected, abs=EXACT)
    assert limits_of(3)[1].upper.ratio == pytest.approx(expected, abs=EXACT)


@pytest.mark.parametrize("birds", [4, 7, 8, 13, 31])
def test_lower_limits_fall_from_the_outermost_to_the_leader(birds):
    lower = [limits.lower.ratio for limits in limits_of(birds)]
    assert len(lower) == (birds + 1) // 2
    assert np.all(np.diff(lower) < -1e-3)
    assert lower[0] < 1.0


@pytest.mark.parametrize("other", [{"zero_lift_drag": 0.01}, {"aspect_ratio": 5.0}], ids=str)
def test_limits_depend_on_neither_drag_coefficient_nor_aspect_ratio(other):
    for one, two in zip(limits_of(7), limits_of(7, **other)):
        assert two.lower.ratio == pytest.approx(one.lower.ratio, abs=1e-12)
        assert two.upper.ratio == pytest.approx(one.upper.ratio, abs=1e-12)
    saving = limits_of(7, oswald_efficiency=0.9)
    assert abs(saving[0].upper.ratio - one.upper.ratio) > 1e-3


@pytest.mark.parametrize("coupling", ["nearest", "all"])
def test_limits_of_the_other_wing_are_the_same(coupling):
    found = limits_of(5, modified=[1, 2, 3, 4, 5], coupling=coupling)
    for one, other in zip(found, reversed(found)):
        # All-to-all limits are known to what Newton's method can tell of shares near 1.
        assert other.lower.ratio == pytest.approx(one.lower.ratio, abs=1e-11)
        assert other.upper.ratio == pytest.approx(one.upper.ratio, abs=1e-11)


# --- flocks of any birds ---


def worst_share(ratios, coupling):
    """The largest share of any set of birds, by all sets; of 1..i and i + 1..N where neighbours."""
    sets = shares_of_all_sets(ratios, steady_speed(ratios, coupling), coupling)
    if coupling == "nearest":
        birds = len(ratios)
        rows = [tuple(range(gap)) for gap in range(1, birds)]
        rows += [tuple(range(gap, birds)) for gap in range(1, birds)]
        return max(sets[row] for row in rows)
    return max(sets.values())


@pytest.mark.parametrize("coupling", ["nearest", "all"])
@pytest.mark.parametrize("birds", [3, 5])
def test_limits_of_any_flock_are_where_some_birds_can_just_keep_up(birds, coupling):
    ratios = random_ratios(seed=1, birds=birds, members=1, spread=0.01)[:, 0].round(4).tolist()
    given = entries(np.array(ratios)[:, np.newaxis])
    found = limits_of(
        birds, modified=range(1, birds + 1), coupling=coupling, span_ratios=given, low=0.7
    )
    assert worst_share(ratios, coupling) < 1.0
    told = 0
    for limits in found:
        for end in (limits.lower, limits.upper):
            if end is None:
                continue

            def condition(ratio, bird=limits.bird):
                changed = ratios[: bird - 1] + [ratio] + ratios[bird:]
                return worst_share(changed, coupling) - 1.0

            own = ratios[limits.bird - 1]
            # One change of sign on the way from the present ratio to a little beyond the limit.
            outside = end.ratio + 0.01 * np.sign(end.ratio - own)
            expected = brentq(condition, own, outside, xtol=1e-15, rtol=1e-15)
            assert end.ratio == pytest.approx(expected, abs=EXACT)
            told += 1
    assert told >= 2 * birds - 2


@pytest.mark.parametrize("birds", [3, 4, 5])
def test_limits_all_to_all_are_where_some_set_of_birds_can_just_keep_up(birds):
    for limits in limits_of(birds, coupling="all"):
        for end, inwards in ((limits.lower, 1e-8), (limits.upper, -1e-8)):
            inside, outside = np.ones(birds), np.ones(birds)
            inside[limits.bird - 1] = end.ratio + inwards
            outside[limits.bird - 1] = end.ratio - inwards
            assert worst_share(inside.tolist(), "all") < 1.0
            assert worst_share(outside.tolist(), "all") > 1.0


# --- what opens ---


@pytest.mark.parametrize("birds", [4, 8, 13])
def test_below_the_lower_limit_the_outer_birds_are_left_behind(birds):
    for limits in limits_of(birds):
        ahead, behind = range(limits.bird + 1, birds + 1), range(1, limits.bird + 1)
        if 2 * limits.bird == birds + 1:  # both wings leave their leader
            assert [limits.bird] in limits.lower.parts
            assert len(limits.lower.parts) == 3
            continue
        assert limits.lower.parts == [list(ahead), list(behind)]
        assert limits.lower.gap == limits.bird


@pytest.mark.parametrize("birds", [5, 8])
def test_above_the_upper_limit_the_neighbours_stay_with_the_large_bird(birds):
    # R = C is where standard birds part from one another; C' saves more than C.
    for limits in limits_of(birds):
        near = [b for b in (limits.bird - 1, limits.bird, limits.bird + 1) if b >= 1]
        assert limits.upper.parts[0] == near


# --- edges ---


def test_inside_of_the_limits_there_are_none():
    for limits in limits_of(7, low=0.999, high=1.01):
        assert (limits.lower, limits.upper, limits.never) == (None, None, False)


def test_one_end_can_be_beyond_what_is_searched():
    one = limits_of(7, low=0.99)[1]
    assert one.lower is None
    assert one.upper.ratio == pytest.approx(limits_of(7)[1].upper.ratio, abs=EXACT)
    other = limits_of(7, high=1.05)[1]
    assert other.upper is None
    assert other.lower.ratio == pytest.approx(lower_limit(7, 2), abs=EXACT)


def test_a_flock_with_another_bird_too_small_is_never_kept():
    for coupling in ("nearest", "all"):
        for limits in limits_of(7, modified=[5, 7], coupling=coupling, span_ratios=("2=0.6",)):
            assert limits.never
            assert limits.lower is None
            assert limits.upper is None


def test_where_the_present_ratio_does_not_keep_a_flock_the_nearest_interval_is_told():
    usual = limits_of(7, modified=[2])[0]
    for present in ("2=0.9", "2=1.2"):
        found = limits_of(7, modified=[2], span_ratios=(present,))[0]
        assert found.lower.ratio == pytest.approx(usual.lower.ratio, abs=1e-12)
        assert found.upper.ratio == pytest.approx(usual.upper.ratio, abs=1e-12)
        assert not found.never


def test_limits_are_told_of_the_interval_that_is_searched_only():
    # The present ratio, 0.9, is outside of it, and so is the lower limit, 0.935.
    found = limits_of(3, modified=[1], low=0.95, span_ratios=("1=0.9",))[0]
    assert found.lower is None
    assert found.upper.ratio == pytest.approx(limits_of(3)[0].upper.ratio, abs=EXACT)


def test_a_bird_alone_needs_a_speed_at_which_thrust_balances_drag():
    # lambda H_0 >= 1, and no gap opens where it isn't.
    (found,) = limits_of(1)
    assert found.lower.ratio == pytest.approx(1.0 / H_0, abs=EXACT)
    assert found.lower.gap is None
    assert found.upper is None


def test_a_limit_where_no_speed_balances_the_forces_has_no_gap():
    # Two birds, the other of 0.8: the square root in U*^2 ends.
    (found,) = limits_of(2, modified=[1], span_ratios=("2=0.8",))

    def radicand(ratio):
        squares, fourths = ratio**2 + 0.8**2, ratio**4 + 0.8**4
        return (H_0 * fourths) ** 2 - squares * (fourths + pair_of(ratio, 0.8, 1.0))

    expected = brentq(radicand, 0.8, 1.0, xtol=1e-15)
    assert found.lower.ratio == pytest.approx(expected, abs=EXACT)
    assert found.lower.gap is None
    assert found.lower.parts is None
    assert found.upper.gap == 1


@pytest.mark.parametrize(
    ("birds", "entries", "expected"),
    [
        (1, (), [1]),
        (2, (), [1]),
        (5, (), [1, 2, 3]),
        (6, (), [1, 2, 3]),
        (5, ("1=1.1", "5=1.1"), [1, 2, 3]),
        (5, ("1=1.1",), [1, 2, 3, 4, 5]),
    ],
)
def test_one_wing_tells_all_of_a_flock_that_mirrors_itself(birds, entries, expected):
    assert modified_birds(FlockConfiguration(birds=birds, span_ratios=entries)) == expected


# --- the search, with flocks that are made up ---


class MadeUp:
    """Flocks of standard birds whose bird m holds within `intervals[m]`; gap m opens above it, gap
    10 + m below, and none is named above 1.9."""

    def __init__(self, intervals):
        self.intervals = intervals
        self.rounds = 0
        self.tried = []

    def __call__(self, span_ratio):
        self.rounds += 1
        opened = []
        for column in span_ratio.T:
            modified = np.flatnonzero(column != 1.0)
            assert len(modified) <= 1
            bird = int(modified[0]) + 1 if len(modified) else 0
            ratio = column[bird - 1] if bird else 1.0
            self.tried.append((bird, ratio))
            low, high = self.intervals.get(bird, (0.0, 2.0))
            above = NO_GAP if ratio > 1.9 else bird
            opened.append(10 + bird if ratio < low else above if ratio > high else 0)
        return np.array(opened)


INTERVALS = {1: (0.91, 1.07), 2: (0.83, 1.93), 3: (0.1, 1.2), 4: (0.97, 5.0)}


@pytest.mark.parametrize("grid", [1, 7, 200])
@pytest.mark.parametrize("sections", [2, 3, 5])
@pytest.mark.parametrize("resolution", [1e-2, 1e-6, 1e-12])
def test_ends_are_found_to_the_resolution(grid, sections, resolution):
    configuration = FlockConfiguration(birds=5)
    found = search(
        configuration, [1, 2, 3, 4], LOW, HIGH, resolution, MadeUp(INTERVALS), grid, sections
    )
    assert [limits.bird for limits in found] == [1, 2, 3, 4]
    for limits in found:
        low, high = INTERVALS[limits.bird]
        # To half the resolution, and a rounding.
        half = 0.5 * resolution + 4e-16
        if low < LOW:
            assert limits.lower is None
        else:
            assert abs(limits.lower.ratio - low) <= half
            assert limits.lower.gap == 10 + limits.bird
        if high > HIGH:
            assert limits.upper is None
        else:
            assert abs(limits.upper.ratio - high) <= half
            assert limits.upper.gap == (None if high > 1.9 else limits.bird)
        assert not limits.never


def test_a_round_tries_all_ends_at_once_and_more_sections_take_fewer_rounds():
    rounds = {}
    for sections in (2, 5):
        flocks = MadeUp(INTERVALS)
        search(FlockConfiguration(birds=5), [1, 2, 3, 4], LOW, HIGH, 1e-6, flocks, 1, sections)
        rounds[sections] = flocks.rounds
    # 1 of them for the grid; 1.0 / 1e-6 is 2^19.9, 5^8.6: from 1 to the far end of the interval.
    assert rounds == {2: 21, 5: 10}


def test_only_the_searched_interval_and_the_present_ratio_are_tried():
    flocks = MadeUp({2: (0.96, 1.05)})
    search(FlockConfiguration(birds=4), [2], 0.9, 1.1, 1e-6, flocks, 10)
    assert min(ratio for _, ratio in flocks.tried) == 0.9
    assert max(ratio for _, ratio in flocks.tried) == 1.1
    assert {bird for bird, _ in flocks.tried} == {0, 2}


@pytest.mark.parametrize("sections", [2, 7])
def test_tried_ratios_are_sums_of_a_start_and_whole_steps(sections):
    # They are flown by `limits`, so they must have the same bits on every machine.
    flocks = MadeUp({2: (0.813, 1.21)})
    search(FlockConfiguration(birds=4), [2], 0.7, 1.3, 1e-3, flocks, 9, sections)
    tried = {ratio for bird, ratio in flocks.tried if bird == 2}
    grid = [0.7 + k * ((1.3 - 0.7) / 9) for k in range(9)] + [1.3]
    assert set(grid) <= tried
    for inside, outside in ((grid[2], grid[1]), (grid[7], grid[8])):
        step = (outside - inside) / sections
        assert {inside + k * step for k in range(1, sections)} <= tried


def test_wings_beside_small_neighbours_are_not_brought_together():
    smallest = []

    def trial(span_ratio):
        smallest.append(np.min(span_ratio[:-1] + span_ratio[1:]))
        return np.zeros(span_ratio.shape[1], dtype=np.int64)

    configuration = FlockConfiguration(birds=3, span_ratios=("3=0.7",))
    found = search(configuration, [2], 0.1, 2.0, 1e-6, trial, 50)
    assert min(smallest) > 1.0
    assert min(smallest) == pytest.approx(1.0, abs=1e-5)
    assert found[0].lower is None


def test_a_ratio_that_keeps_a_flock_is_found_between_the_ends_of_the_grid():
    # The present one is tried besides.
    found = search(
        FlockConfiguration(birds=3, span_ratios=()),
        [2],
        LOW,
        HIGH,
        1e-9,
        MadeUp({2: (0.9999, 1.0001)}),
        3,
    )
    assert found[0].lower.ratio == pytest.approx(0.9999, abs=1e-9)
    assert found[0].upper.ratio == pytest.approx(1.0001, abs=1e-9)


def test_the_search_ends_where_numbers_are_further_apart_than_the_resolution():
    # Numbers near 1000 are multiples of 2^-43 = 1.1e-13, and 2 / 2^-43 is 2^44: 45 rounds.
    rounds = 0

    def trial(span_ratio):
        nonlocal rounds
        rounds += 1
        assert rounds < 100, "the search goes on for ever"
        return np.where(span_ratio[0] > 1000.3, 1, 0)

    configuration = FlockConfiguration(birds=2, span_ratios=("1=1000", "2=1000"))
    (found,) = search(configuration, [1], 999.0, 1001.0, 1e-13, trial)
    assert found.upper.ratio == pytest.approx(1000.3, abs=1e-12)


def test_a_bird_that_nothing_helps_does_not_keep_others_from_their_limits():
    def trial(span_ratio):
        hopeless = span_ratio[0] == 1.0
        return np.where(hopeless, 2, np.where(span_ratio[0] > 1.25, 1, 0))

    found = search(FlockConfiguration(birds=4), [1, 2], LOW, HIGH, 1e-6, trial, 11)
    assert found[0].upper.ratio == pytest.approx(1.25, abs=1e-6)
    assert found[1].never
    assert found[1].lower is None


def test_five_sections_find_the_limits_of_real_flocks_too():
    exact = limits_of(5)

    def trial(span_ratio):
        return np.array(
            [0 if worst_share(column.tolist(), "nearest") < 1.0 else 1 for column in span_ratio.T]
        )

    configuration = FlockConfiguration(birds=5)
    for sections in (2, 5):
        found = search(configuration, [1, 2, 3], 0.7, 1.3, 1e-4, trial, 1, sections)
        for limits, other in zip(found, exact):
            assert abs(limits.lower.ratio - other.lower.ratio) <= 5e-5
            assert abs(limits.upper.ratio - other.upper.ratio) <= 5e-5


def test_an_end_is_plain_data():
    assert End(0.9, 2) == End(ratio=0.9, gap=2, parts=None)
