# SPDX-License-Identifier: Apache-2.0
"""The best orders of birds are those of all orders, however they are found."""

from itertools import permutations

import numpy as np
import pytest

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.physics.scaling import Scales
from flock_sim.theory.arrangement import arrange as arrange_module
from flock_sim.theory.arrangement import bounds as bounds_module
from flock_sim.theory.arrangement import branch_and_bound
from flock_sim.theory.arrangement.arrange import arrange
from flock_sim.theory.arrangement.orders import Kinds
from support.steady_flocks import H_0, STRENGTH, A, across, even
from support.steady_states import steady

SCALES = Scales.of(FlockConfiguration())


def arranged(coupling, spans):
    """The best orders of birds of the goose's kind."""
    return arrange(FlockConfiguration(coupling=coupling), spans)


RESULTS = ("fastest", "fastest_flying", "firmest", "closest")


def spans_of(seed):
    """Random birds, 2 to 7: from almost equal ones to very unequal ones, a third with twins."""
    random = np.random.default_rng(seed)
    birds = 2 + seed % 6
    spans = random.normal(1.0, (0.003, 0.01, 0.03, 0.1)[seed % 4], birds)
    return random.choice(spans[: (birds + 2) // 2], birds) if seed % 3 == 0 else spans


def all_orders(spans):
    """All orders that do not exceed their mirror images, ascending, shape (orders, birds)."""
    ascending = permutations(sorted(spans.tolist()))
    return np.array(sorted({order for order in ascending if order <= order[::-1]}))


def brute_force(spans, coupling):
    """All orders, their speeds, and their margins over all sets of birds, by plain NumPy."""
    orders = all_orders(spans)
    birds = len(spans)
    saved = np.zeros((len(orders), birds, birds))
    for number, order in enumerate(orders.tolist()):
        side = across(order)
        for i in range(birds):
            for j in range(i + 1, birds if coupling == "all" else min(birds, i + 2)):
                pair = even(side[j] - side[i], A * order[i], A * order[j])
                saved[number, i, j] = STRENGTH * (order[i] * order[j]) ** 2 * pair
    squares, fourths = (orders**2).sum(axis=1), (orders**4).sum(axis=1)
    half = H_0 * fourths
    square = half + np.sqrt(half**2 - squares * (fourths + saved.sum(axis=(1, 2))))
    square /= squares
    saved /= square[:, np.newaxis, np.newaxis]
    needed = 2.0 * H_0 * orders**4 - orders**2 * square[:, np.newaxis]
    needed -= orders**4 / square[:, np.newaxis]
    margin = np.full(len(orders), np.inf)
    for number in range(1, 2**birds - 1):
        inside = np.array([number >> bird & 1 for bird in range(birds)], dtype=bool)
        within = saved[:, inside][:, :, inside].sum(axis=(1, 2))
        across_it = saved[:, inside][:, :, ~inside].sum(axis=(1, 2))
        across_it = across_it + saved[:, ~inside][:, :, inside].sum(axis=(1, 2))
        share = (needed[:, inside].sum(axis=1) - within) / across_it
        margin = np.minimum(margin, 1.0 - share)
    return orders, np.sqrt(square), margin


def check(result, orders, speed, margin, wanted):
    """Check that `result` is the first order with the largest `wanted`."""
    if np.isnan(wanted).all():
        assert result is None
        return
    best = int(np.argmax(wanted >= np.nanmax(wanted) - 1e-12))
    assert result.order.tolist() == orders[best].tolist()
    assert result.speed == pytest.approx(speed[best], abs=1e-13)
    assert result.margin == pytest.approx(margin[best], abs=1e-11)
    assert result.proven
    assert result.flies == (margin[best] > 0.0)


@pytest.mark.parametrize(
    ("coupling", "method"),
    [("nearest", "all orders"), ("all", "all orders"), ("nearest", "branch and bound")],
)
def test_results_are_those_of_all_orders(coupling, method, monkeypatch):
    if method == "branch and bound":
        monkeypatch.setattr(arrange_module, "MOST_COUNTED", 0)
    none_flies, proud = 0, 0
    for seed in range(50):
        spans = spans_of(seed)
        orders, speed, margin = brute_force(spans, coupling)
        found = arranged(coupling, spans)
        flying = margin > 0.0
        none_flies += not flying.any()
        assert found.orders == len(orders)
        assert found.flying == (None if method == "branch and bound" else flying.sum())
        check(found.fastest, orders, speed, margin, speed)
        check(found.fastest_flying, orders, speed, margin, np.where(flying, speed, np.nan))
        some, none = (margin, np.full(len(margin), np.nan))[:: 1 if flying.any() else -1]
        check(found.firmest, orders, speed, margin, some)
        check(found.closest, orders, speed, margin, none)
        assert (found.method, found.algorithm) == ("exact", method)
        if found.fastest_flying is not None:
            proud += found.fastest_flying.speed < found.fastest.speed
    # The sets are of all sorts: some fly in no order, some not in the fastest one.
    assert none_flies >= 3
    assert proud >= 3


def same(one, other):
    for name in RESULTS:
        a, b = getattr(one, name), getattr(other, name)
        assert (a is None) == (b is None)
        assert a is None or (a.order.tolist() == b.order.tolist() and a.proven == b.proven)


@pytest.mark.parametrize("spread", [0.004, 0.03, 0.1])
def test_ten_birds_are_searched_as_exactly_as_tried(spread, monkeypatch):
    spans = np.random.default_rng(10).normal(1.0, spread, 10)
    tried = arranged("nearest", spans)
    monkeypatch.setattr(arrange_module, "MOST_COUNTED", 0)
    same(arranged("nearest", spans), tried)
    assert tried.orders == 1814400


def test_an_order_at_the_edge_of_what_flies_is_proven_soon(monkeypatch):
    # Halving the interval of W(all) is no help here: many begun orders can still have any W(all).
    spans = [
        0.987357564587992, 0.9881370631278178, 0.9885203061889665, 0.9900091043304408,
        0.9913707007769649, 0.9960858865835, 0.9974552194038379, 1.000155839340559,
        1.006362796663018, 1.0064944527534079, 1.0083928898171612, 1.0087275116866226,
        1.009547403510078
    ]  # fmt: skip
    monkeypatch.setattr(branch_and_bound, "MOST_WORK", 20_000_000)
    found = arranged("nearest", np.array(spans))
    assert found.method == "exact"
    assert 0.0 < found.fastest_flying.margin < 1e-9


@pytest.mark.parametrize("seed", range(12))
def test_halved_intervals_change_no_result(seed, monkeypatch):
    spans = np.random.default_rng(seed).normal(1.0, (0.01, 0.05, 0.1)[seed % 3], 8)
    tried = arranged("nearest", spans)
    monkeypatch.setattr(arrange_module, "MOST_COUNTED", 0)
    monkeypatch.setattr(branch_and_bound, "BUDGET", 300)
    same(arranged("nearest", spans), tried)


def test_bounds_cut_no_wanted_order():
    checked = sum(map(wanted_orders_within_bounds, range(24)))
    assert checked >= 1000


def wanted_orders_within_bounds(seed):
    """Check the bounds of all states that wanted orders pass; return the number of such orders."""
    kinds = Kinds.of(SCALES, "nearest", spans_of(seed))
    search = branch_and_bound.ChainSearch(kinds)
    tables, bounds = search.tables, search._bounds
    orders = kinds.all_orders()
    speed, margin = kinds.values(orders)
    level = float(np.median(margin))
    saved = [search.saved_at(one) for one in speed]
    low, high = float(np.quantile(saved, 0.3)) - 1e-9, float(np.quantile(saved, 0.9)) + 1e-9
    bounds_module.fill_bounds(tables, bounds, level - 1e-9, low, high)
    wanted = [i for i in range(len(orders)) if margin[i] >= level and low <= saved[i] <= high]
    for order, total in zip(orders[wanted].tolist(), np.array(saved)[wanted], strict=True):
        now, within = 0, 0.0
        for place, kind in enumerate(order):
            now += int(tables.radix[kind])
            within += tables.saved[order[place - 1], kind] if place else 0.0
            assert bounds.low[now, kind] - 1e-12 <= within <= bounds.high[now, kind] + 1e-12
            left = total - within
            assert bounds.least[now, kind] - 1e-9 <= left <= bounds.most[now, kind] + 1e-9
    return len(wanted)


@pytest.mark.parametrize("counts", [(1,), (4,), (1, 1), (2, 3), (2, 2, 2), (1, 2, 1, 2), (3, 1, 1)])
def test_orders_are_counted_without_mirror_images_and_listed_in_order(counts):
    spans = np.repeat(1.0 + 0.1 * np.arange(len(counts)), counts)
    kinds = Kinds.of(SCALES, "nearest", spans)
    expected = all_orders(spans)
    assert kinds.orders == len(expected)
    np.testing.assert_array_equal(kinds.ratio[kinds.all_orders()], expected)


def test_results_are_steady_states_of_equilibrium():
    spans = np.array([1.0, 0.98, 1.03, 1.01, 0.99])
    for coupling in ("nearest", "all"):
        found = arranged(coupling, spans)
        for result in (found.fastest_flying, found.firmest):
            state = steady(5, result.order, coupling=coupling)
            assert state.exists[0]
            assert result.speed == state.speed[0]
            assert result.margin == state.margin[0]
            assert result.saving == pytest.approx(state.drag_reduction.mean(), abs=1e-15)


@pytest.mark.parametrize("coupling", ["nearest", "all"])
def test_equal_birds_have_one_order(coupling):
    found = arranged(coupling, np.ones(13))
    assert (found.orders, found.flying) == (1, 1)
    for result in (found.fastest, found.fastest_flying, found.firmest):
        assert result.order.tolist() == [1.0] * 13
        assert result.speed == steady(13, coupling=coupling).speed[0]


@pytest.mark.parametrize("most", [0, 360])
def test_of_orders_that_differ_by_rounding_only_the_smallest_is_taken(most, monkeypatch):
    # The row between twins can be reversed: neighbours stay neighbours, so U* stays as it is.
    spans = np.array([0.9, 0.91, 1.0, 1.0, 1.1, 1.2])
    monkeypatch.setattr(arrange_module, "MOST_COUNTED", most)
    first, other = [0.9, 1.0, 1.1, 1.2, 1.0, 0.91], [0.9, 1.0, 1.2, 1.1, 1.0, 0.91]
    speeds = [steady(6, order).balanced_speed[0] for order in (first, other)]
    assert speeds[0] == pytest.approx(speeds[1], abs=1e-15)
    assert arranged("nearest", spans).fastest.order.tolist() == first


def test_a_bird_alone_and_two_birds():
    alone = arranged("nearest", np.array([1.02]))
    assert (alone.orders, alone.flying, alone.firmest.margin) == (1, 1, np.inf)
    two = arranged("all", np.array([1.02, 0.99]))
    assert (two.orders, two.flying) == (1, 1)
    assert two.fastest.order.tolist() == two.firmest.order.tolist() == [0.99, 1.02]


@pytest.mark.parametrize("coupling", ["nearest", "all"])
def test_where_none_can_fly_the_closest_is_told(coupling):
    found = arranged(coupling, np.array([0.7, 1.0, 1.4]))
    assert (found.orders, found.flying) == (3, 0)
    assert found.fastest_flying is None
    assert found.firmest is None
    assert np.isnan(found.closest.saving)
    assert found.closest.margin == max(found.margin) < 0.0 < found.fastest.speed


@pytest.mark.parametrize("most", [0, 10])
def test_birds_whose_vortices_would_meet_are_no_neighbours(most, monkeypatch):
    monkeypatch.setattr(arrange_module, "MOST_COUNTED", most)
    found = arranged("nearest", np.array([0.45, 0.5, 1.2]))
    assert found.orders == 3
    assert found.fastest.order.tolist() == [0.45, 1.2, 0.5]
    nowhere = arranged("nearest", np.array([0.4, 0.45, 0.5]))
    assert [getattr(nowhere, name) for name in RESULTS] == [None] * 4


def test_a_search_that_gives_up_says_so(monkeypatch):
    monkeypatch.setattr(arrange_module, "MOST_COUNTED", 0)
    monkeypatch.setattr(branch_and_bound, "BUDGET", 3)
    monkeypatch.setattr(branch_and_bound, "MOST_WORK", 9)
    found = arranged("nearest", spans_of(5))
    assert found.method == "local search"
    assert not found.firmest.proven


def test_beyond_the_exact_methods_a_local_search_finds_good_orders(monkeypatch):
    spans = np.random.default_rng(4).normal(1.0, 0.03, 7)
    for coupling in ("nearest", "all"):
        exact = arranged(coupling, spans)
        with monkeypatch.context() as patched:
            patched.setattr(arrange_module, "MOST_COUNTED", 0)
            patched.setattr(arrange_module, "MOST_STATES", 0)
            found = arranged(coupling, spans)
            same(found, arranged(coupling, spans[::-1]))
        assert (found.method, found.algorithm, found.flying) == ("local search",) * 2 + (None,)
        for name in RESULTS[:3]:
            # Seven birds are few enough for 16 starts.
            assert getattr(found, name).order.tolist() == getattr(exact, name).order.tolist()
            assert not getattr(found, name).proven
