# SPDX-License-Identifier: Apache-2.0
"""The leader, the neighbours and the start position of each bird."""

from math import atan2, degrees, pi

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from flock_sim.physics import formation

EPS = 2.0**-52

flocks = st.integers(1, 40)


@pytest.mark.parametrize(
    ("birds", "leader"), [(1, 1), (2, 2), (3, 2), (4, 3), (5, 3), (12, 7), (13, 7), (31, 16)]
)
def test_leader_is_the_middle_bird(birds, leader):
    assert formation.leader(birds) == leader


@given(birds=flocks.filter(lambda birds: birds % 2 == 1))
def test_leader_of_an_odd_flock_is_the_papers(birds):
    assert formation.leader(birds) == (birds + 1) // 2


def test_nearest_neighbours_are_those_beside():
    assert formation.neighbours(1, 1, "nearest") == ()
    assert formation.neighbours(1, 4, "nearest") == (2,)
    assert formation.neighbours(2, 4, "nearest") == (1, 3)
    assert formation.neighbours(4, 4, "nearest") == (3,)


def test_coupled_to_all_everybody_else_is_a_neighbour_in_ascending_order():
    assert formation.neighbours(1, 1, "all") == ()
    assert formation.neighbours(3, 5, "all") == (1, 2, 4, 5)


@given(birds=flocks, coupling=st.sampled_from(["nearest", "all"]))
def test_whom_i_feel_feels_me(birds, coupling):
    for bird in range(1, birds + 1):
        for other in formation.neighbours(bird, birds, coupling):
            assert bird in formation.neighbours(other, birds, coupling)


@given(birds=flocks, coupling=st.sampled_from(["nearest", "all"]))
def test_every_interacting_pair_is_named_once_in_ascending_order(birds, coupling):
    pairs = list(formation.pairs(birds, coupling))
    assert pairs == sorted(set(pairs))
    assert all(low < high for low, high in pairs)
    assert len(pairs) == (birds - 1 if coupling == "nearest" else birds * (birds - 1) // 2)


def test_neighbours_overlap_by_the_optimal_tip_spacing():
    # b_i + b_j + s_opt with s_opt = (pi/4 - 1) b; one rounding per addition of numbers below 4.
    ratio = np.array([[0.9, 1.0], [1.2, 1.0]])
    expected = [0.9 + 1.2 - (1.0 - pi / 4.0), 1.0 + pi / 4.0]
    np.testing.assert_allclose(formation.lateral_distance(ratio), expected, rtol=0, atol=4 * EPS)


@given(st.lists(st.floats(0.6, 2.0), min_size=2, max_size=30))
def test_lateral_distance_adds_up_along_the_wing(ratios):
    row = np.array(ratios)[:, np.newaxis]
    steps = [formation.lateral_distance(row[i : i + 2])[0] for i in range(len(ratios) - 1)]
    # Same numbers, added in the same order: not a bit between them.
    total = 0.0
    for step in steps:
        total += step
    assert formation.lateral_distance(row)[0] == total


@given(st.lists(st.floats(0.6, 2.0), min_size=1, max_size=30))
def test_lateral_positions_ascend_from_tail_to_head_with_the_leader_at_zero(ratios):
    row = np.array(ratios)[:, np.newaxis]
    lateral = formation.lateral_positions(row)[:, 0]
    assert lateral[formation.leader(len(ratios)) - 1] == 0.0
    # Differences of sums of up to 30 numbers below 4, each sum below 120: 30 roundings of 120 eps.
    gaps = [formation.lateral_distance(row[i : i + 2])[0] for i in range(len(ratios) - 1)]
    np.testing.assert_allclose(np.diff(lateral), gaps, rtol=0, atol=30 * 120 * EPS)


@pytest.mark.parametrize("birds", [1, 3, 7, 13])
def test_lateral_positions_mirror(birds):
    lateral = formation.lateral_positions(np.ones((birds, 2)))
    np.testing.assert_array_equal(lateral, -lateral[::-1])


@pytest.mark.parametrize("birds", [2, 3, 4, 13])
def test_flight_starts_in_a_v_of_45_degrees_half_angle_with_the_leader_at_its_tip(birds):
    lateral = formation.lateral_positions(np.ones((birds, 1)))[:, 0]
    head = formation.leader(birds)
    assert formation.start_position(head, birds) == 0.0
    for bird in range(1, birds + 1):
        if bird != head:
            behind = -formation.start_position(bird, birds)
            angle = degrees(atan2(abs(lateral[bird - 1]), behind))
            # A sum of up to 12 spacings is some ulps off.
            assert angle == pytest.approx(45.0, abs=45.0 * 16 * EPS)


@given(birds=flocks)
def test_start_positions_are_whole_multiples_of_the_standard_spacing(birds):
    # Not of a quotient by tan(pi / 4), whose last bit depends on the C library.
    head = formation.leader(birds)
    for bird in range(1, birds + 1):
        assert formation.start_position(bird, birds) == -abs(bird - head) * (1.0 + pi / 4.0)


@given(birds=flocks)
def test_start_mirrors_about_the_leader(birds):
    head = formation.leader(birds)
    for away in range(1, birds - head + 1):
        left, right = head - away, head + away
        assert formation.start_position(left, birds) == formation.start_position(right, birds)
