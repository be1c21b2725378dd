# SPDX-License-Identifier: Apache-2.0
"""The worst set of birds of a flock is the worst of all sets, and minimum cuts find it."""

import numpy as np
import pytest

from support.steady_flocks import STRENGTH, A, across, random_ratios, shares_of_all_sets, surplus
from support.steady_states import steady


def birds_of(state, member=0):
    """The worst set of a member, from 0."""
    return tuple(np.flatnonzero(state.worst_set[:, member]).tolist())


@pytest.mark.parametrize("coupling", ["nearest", "all"])
@pytest.mark.parametrize(
    ("birds", "members", "spread"),
    [(2, 30, 0.05), (3, 40, 0.15), (4, 30, 0.1), (5, 30, 0.04), (6, 30, 0.1), (7, 20, 0.02),
     (8, 10, 0.2), (9, 6, 0.01), (10, 4, 0.05)],
)  # fmt: skip
def test_the_margin_is_the_least_of_all_sets(birds, members, spread, coupling):
    # 200 flocks. A share is a quotient of sums of some 50 numbers of one sign and size.
    ratios = random_ratios(seed=birds, birds=birds, members=members, spread=spread)
    state = steady(birds, ratios, coupling=coupling)
    checked = 0
    for member in np.flatnonzero(np.isfinite(state.balanced_speed)):
        column, speed = ratios[:, member].tolist(), state.balanced_speed[member]
        sets = shares_of_all_sets(column, speed, coupling)
        largest = max(sets.values())
        assert state.margin[member] == pytest.approx(1.0 - largest, abs=1e-10)
        assert sets[birds_of(state, member)] == pytest.approx(largest, abs=1e-10)
        checked += 1
    assert checked >= 0.9 * members


def test_a_leader_that_almost_falls_behind_is_found():
    # Every gap's share is far from its end; the leader's is 1.2e-4 from it.
    ratios = np.ones(7)
    ratios[3] = 0.8004
    state = steady(7, ratios, coupling="all")
    assert np.minimum(state.share, 1.0 - state.share).min() > 0.19
    assert state.margin[0] == pytest.approx(1.168e-4, abs=5e-8)
    assert birds_of(state) == (3,)
    assert state.worst_gap.tolist() == [0]
    assert state.exists[0]
    ratios[3] = 0.8
    assert not steady(7, ratios, coupling="all").exists[0]


@pytest.mark.parametrize("birds", [3, 4, 7, 8, 13])
def test_of_equal_birds_both_tails_are_the_worst_set(birds):
    # A mirror image of a worst set would be worst as well, and both together would be worse.
    state = steady(birds, coupling="all")
    assert birds_of(state) == (0, birds - 1)
    assert state.worst_gap.tolist() == [0]
    assert 0.0 < state.margin[0] < np.minimum(state.share, 1.0 - state.share).min()


def test_a_worst_set_on_one_side_of_a_gap_has_this_gap():
    small_tail, small_head = np.ones(6), np.ones(6)
    small_tail[0], small_head[-1] = 0.95, 0.95
    state = steady(6, np.stack([small_tail, small_head], axis=1), coupling="all")
    assert [birds_of(state, member) for member in (0, 1)] == [(0,), (5,)]
    assert state.worst_gap.tolist() == [1, 5]
    np.testing.assert_allclose(
        state.margin, [1.0 - state.share[0, 0], state.share[4, 1]], rtol=0, atol=1e-14
    )


def test_the_worst_set_of_neighbours_falls_behind_the_weakest_gap():
    ratios = random_ratios(seed=3, birds=6, members=40, spread=0.03)
    state = steady(6, ratios)
    assert state.worst_gap.tolist() == state.weakest_gap.tolist()
    for member, gap in enumerate(state.weakest_gap):
        before = state.share[gap - 1, member] >= 0.5
        assert birds_of(state, member) == (tuple(range(gap)) if before else tuple(range(gap, 6)))


@pytest.mark.parametrize("spread", [0.0, 0.001, 0.01])
def test_a_large_flock_has_no_set_that_single_changes_make_worse(spread):
    # Too many sets to try all: a local test of those found for 101 birds.
    ratios = random_ratios(seed=101, birds=101, members=1, spread=spread)
    state = steady(101, ratios, coupling="all")
    worst = state.worst_set[:, 0]
    least = min(
        1.0 - share_in(ratios[:, 0], state.balanced_speed[0], worst ^ (np.arange(101) == bird))
        for bird in range(101)
        if 0 < (worst ^ (np.arange(101) == bird)).sum() < 101
    )
    assert state.margin[0] == pytest.approx(
        1.0 - share_in(ratios[:, 0], state.balanced_speed[0], worst), abs=1e-12
    )
    assert state.margin[0] <= min(least, (1.0 - state.share).min(), state.share.min()) + 1e-12


def share_in(ratios, speed, behind):
    """The share of one set of a large flock, from the formulas of `support.steady_flocks`."""
    side = np.array(across(ratios.tolist()))
    gaps = np.abs(side[:, None] - side[None, :])
    half, other = A * ratios[:, None], A * ratios[None, :]
    with np.errstate(all="ignore"):
        pair = STRENGTH * (ratios[:, None] * ratios[None, :]) ** 2 / speed**2
        pair = pair * np.log(1.0 - 4.0 * half * other / (gaps**2 - (half - other) ** 2))
    np.fill_diagonal(pair, 0.0)
    own = 0.5 * pair[np.ix_(behind, behind)].sum()
    needed = sum(surplus(ratio, speed) for ratio in ratios[behind])
    return (needed - own) / pair[np.ix_(behind, ~behind)].sum()
