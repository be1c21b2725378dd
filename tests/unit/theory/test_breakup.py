# SPDX-License-Identifier: Apache-2.0
"""The breakup of flocks, against flights and against all possible partitions."""

from itertools import pairwise, product

import numpy as np
import pytest
from scipy.optimize import brentq

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.physics.flock import Flock
from flock_sim.reference.integrator import Reference
from flock_sim.theory.breakup import opening_gap, parts
from flock_sim.theory.equilibrium import equilibrium
from support.steady_flocks import pair_of, random_ratios, surplus
from support.steady_states import flock_of


def parted(ratios, **parameters):
    """The parts of each member, and the gap that is named for it."""
    flock = flock_of(len(ratios), ratios, **parameters)
    state = equilibrium(flock)
    groups = [parts(flock, state, member) for member in range(flock.members)]
    return groups, [opening_gap(state, group, m) for m, group in enumerate(groups)], state


# --- what is seen in flight ---


def assert_seen_in_flight(birds, flocks, spread, coupling="nearest"):
    """Fly random flocks that have no formation to t = 8e4, and watch their gaps."""
    configuration = FlockConfiguration(
        birds=birds, coupling=coupling, t_max=8e4, record_every=80000
    )
    drawn = random_ratios(seed=birds, birds=birds, members=4 * flocks, spread=spread)
    exists = equilibrium(Flock.of(configuration, drawn)).exists
    ratios = np.ascontiguousarray(drawn[:, np.flatnonzero(~exists)[:flocks]])
    assert ratios.shape[1] == flocks
    flight = Reference(configuration, ratios)
    gaps = []
    for steps in (40000, 20000, 20000):
        flight.advance(steps)
        gaps.append(np.abs(np.diff(flight.position, axis=0)))
    first, second = gaps[1] - gaps[0], gaps[2] - gaps[1]  # over [2 T, 3 T] and [3 T, 4 T]

    groups, named, _ = parted(ratios, coupling=coupling)
    for member, (group, gap) in enumerate(zip(groups, named)):
        assert len(group) >= 2
        assert sorted(bird for part in group for bird in part) == list(range(1, birds + 1))
        # Parts that fly at two speeds move apart as much in every T. They are already far apart:
        # what they still do to each other fades as 1 / x^2.
        assert second[gap - 1, member] / first[gap - 1, member] == pytest.approx(1.0, abs=0.1)
        assert second[gap - 1, member] > 5.0

        number = {bird: n for n, part in enumerate(group) for bird in part}
        for i in range(1, birds):
            if number[i] == number[i + 1]:
                # Forces fade as 1 / t^2, and so do changes, the later to (1/9 - 1/16) / (1/4 - 1/9)
                # = 0.35 of the earlier. Of some only the rounding of positions is left, 2^-36 b a
                # step: parts whose speeds differ by 1e-8, the least that counts, part by 2e-4 b.
                here, there = abs(first[i - 1, member]), abs(second[i - 1, member])
                assert there < max(0.75 * here, 1e-5)

        speeds = [flight.speed[[bird - 1 for bird in part], member] for part in group]
        assert max(np.ptp(speed) for speed in speeds) < 1e-5
        means = [speed.mean() for speed in speeds]
        assert means == sorted(means, reverse=True)
        rate = second[gap - 1, member] / 2e4
        apart = abs(means[number[gap]] - means[number[gap + 1]])
        assert rate == pytest.approx(apart, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("birds", "flocks", "spread"), [(7, 60, 0.03), (10, 20, 0.03), (13, 20, 0.02)]
)
def test_flocks_without_a_formation_come_apart_at_the_gap_that_is_named(birds, flocks, spread):
    assert_seen_in_flight(birds, flocks, spread)


@pytest.mark.slow
def test_flocks_without_a_formation_come_apart_at_the_gap_that_is_named_all_to_all():
    assert_seen_in_flight(birds=5, flocks=15, spread=0.06, coupling="all")


# --- all ways to come apart ---

CLOSED, TAIL_AHEAD, HEAD_AHEAD = 0, 1, -1


def speeds_apart(ratios, gaps):
    """The birds' speeds if each open gap parts as `gaps` says, or None where that is impossible.

    A part saves what its pairs save, and all of what the pair across an open gap saves if the birds
    on the other side fly ahead; it gets nothing of that if they lag behind.
    """
    birds = len(ratios)
    groups = [[0]]
    for gap, way in enumerate(gaps):
        if way == CLOSED:
            groups[-1].append(gap + 1)
        else:
            groups.append([gap + 1])
    speeds = [None] * birds

    def speed_of(group):
        if speeds[group[0]] is None:
            ahead = []
            if group[0] > 0 and gaps[group[0] - 1] == TAIL_AHEAD:
                ahead.append((group[0], group[0] - 1))
            if group[-1] < birds - 1 and gaps[group[-1]] == HEAD_AHEAD:
                ahead.append((group[-1], group[-1] + 1))
            for _, other in ahead:
                speed_of(next(one for one in groups if other in one))

            def total(speed):
                force = sum(surplus(ratios[i], speed) for i in group)
                for i, j in pairwise(group):
                    force -= pair_of(ratios[i], ratios[j], speed)
                for i, j in ahead:
                    saving = pair_of(ratios[i], ratios[j], 1.0)
                    force -= saving / (speed * (speeds[j] or np.nan))
                return force

            # Drag grows with speed from its minimum near 1 on: there is one root at most.
            found = brentq(total, 1.0, 5.0, xtol=1e-14) if total(1.0) > 0.0 else np.nan
            for i in group:
                speeds[i] = found
        return speeds[group[0]]

    for group in groups:
        speed_of(group)
    return None if np.isnan(speeds).any() else speeds


def is_possible(ratios, gaps, speeds):
    """Whether open gaps open and closed ones hold."""
    carried = 0.0
    for gap, way in enumerate(gaps):
        one, other = ratios[gap], ratios[gap + 1]
        pair = pair_of(one, other, 1.0) / (speeds[gap] * speeds[gap + 1])
        share = (carried + surplus(one, speeds[gap])) / pair
        expected = {TAIL_AHEAD: 0.0, HEAD_AHEAD: 1.0}.get(way)
        if expected is None:
            if not 0.0 < share < 1.0:
                return False
        else:
            assert share == pytest.approx(expected, abs=1e-10)
            if way * (speeds[gap] - speeds[gap + 1]) <= 0.0:
                return False
        carried += surplus(one, speeds[gap]) - pair
    return True


def grouped(gaps, speeds):
    groups = [[1]]
    for gap, way in enumerate(gaps):
        if way == CLOSED:
            groups[-1].append(gap + 2)
        else:
            groups.append([gap + 2])
    return sorted(groups, key=lambda group: -speeds[group[0] - 1])


def test_parts_are_the_only_ones_in_which_a_flock_can_fly_on():
    ratios = random_ratios(seed=3, birds=5, members=40, spread=0.04)
    groups, named, state = parted(ratios)
    assert 5 < state.exists.sum() < 30
    for member, found in enumerate(groups):
        column = ratios[:, member].tolist()
        ways = []
        for gaps in product((CLOSED, TAIL_AHEAD, HEAD_AHEAD), repeat=4):
            speeds = speeds_apart(column, gaps)
            if speeds and is_possible(column, gaps, speeds):
                ways.append(grouped(gaps, speeds))
        assert ways == [found]
        assert state.exists[member] == (len(found) == 1) == (named[member] == 0)


def test_parts_of_larger_flocks_hold_together_and_leave_one_another():
    ratios = random_ratios(seed=4, birds=13, members=200, spread=0.025)
    groups, _, state = parted(ratios)
    assert not state.exists.all()
    for member, found in enumerate(groups):
        number = {bird: n for n, part in enumerate(found) for bird in part}
        # The first part is the fastest.
        gaps = [np.sign(number[i + 1] - number[i]) for i in range(1, 13)]
        column = ratios[:, member].tolist()
        speeds = speeds_apart(column, gaps)
        assert speeds
        assert is_possible(column, gaps, speeds)
        assert state.exists[member] == (len(found) == 1)


# --- small and clear ---


def test_a_flock_with_a_formation_is_one_part():
    for coupling in ("nearest", "all"):
        groups, named, _ = parted(np.ones((5, 1)), coupling=coupling)
        assert groups == [[[1, 2, 3, 4, 5]]]
        assert named == [0]


@pytest.mark.parametrize("coupling", ["nearest", "all"])
def test_the_larger_of_two_birds_flies_off(coupling):
    groups, named, _ = parted(np.array([[1.3, 1.0], [1.0, 1.3]]), coupling=coupling)
    assert groups == [[[1], [2]], [[2], [1]]]
    assert named == [1, 1]


def test_a_leader_that_is_too_fast_leaves_both_wings():
    # They are in its wake alike: the first of two gaps is named.
    ratios = np.array([[1.0], [1.0], [1.4], [1.0], [1.0]])
    groups, named, _ = parted(ratios)
    assert groups[0][0] == [3]
    assert named[0] in (1, 2)
    everyone, _, _ = parted(ratios, coupling="all")
    assert everyone[0][0] == [3]


def test_a_bird_that_is_too_small_is_left_by_all_others():
    ratios = np.ones((7, 1))
    ratios[0] = 0.9
    for coupling in ("nearest", "all"):
        groups, named, _ = parted(ratios, coupling=coupling)
        assert groups == [[[2, 3, 4, 5, 6, 7], [1]]]
        assert named == [1]


@pytest.mark.parametrize("coupling", ["nearest", "all"])
def test_birds_that_no_speed_keeps_have_no_parts(coupling):
    groups, named, _ = parted(np.full((3, 1), 0.7), coupling=coupling)
    assert groups == [[]]
    assert named == [0]


@pytest.mark.parametrize("coupling", ["nearest", "all"])
def test_a_bird_alone_is_its_only_part(coupling):
    groups, named, _ = parted(np.ones((1, 1)), coupling=coupling)
    assert groups == [[[1]]]
    assert named == [0]


def test_a_mirrored_flock_parts_mirrored():
    ratios = random_ratios(seed=6, birds=6, members=50, spread=0.04)
    one, _, state = parted(ratios)
    other, _, _ = parted(ratios[::-1])
    assert not state.exists.all()
    for groups, mirrored in zip(one, other):
        assert [sorted(7 - bird for bird in part) for part in groups] == mirrored


def test_the_gap_that_is_named_is_the_weakest_of_those_that_open():
    ratios = random_ratios(seed=8, birds=8, members=100, spread=0.03)
    groups, named, state = parted(ratios)
    seen = set()
    for member, (found, gap) in enumerate(zip(groups, named)):
        number = {bird: n for n, part in enumerate(found) for bird in part}
        open_gaps = [i for i in range(1, 8) if number[i] != number[i + 1]]
        room = {
            i: min(state.share[i - 1, member], 1 - state.share[i - 1, member]) for i in open_gaps
        }
        assert gap == min(room, key=room.get, default=0)
        seen.add(gap)
    assert len(seen) > 4
