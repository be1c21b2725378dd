# SPDX-License-Identifier: Apache-2.0
"""The best orders of nearest neighbours, exactly, without trying all: branch and bound.

With u = U*^2, let c_ab = -s lambda_a^2 lambda_b^2 E_ab > 0 be what neighbours a and b save, and

    n(Q) = sum over Q of lambda^2 (u^2 - lambda^2 (2 H_0 u - 1))

what a set Q of birds needs, both in units of k / u (see `steady_speed`). c depends on the two birds
only, since neighbours' lateral distance does. W(Q) is the sum of c over the neighbours within the
first birds Q of an order, so that it depends on their order. Then the sum of all forces gives u,

    n(all) = W(all),

which rises with W(all), and the share of the gap between Q, with a at its end, and the next bird b
is (n(Q) - W(Q)) / c_ab. So the margin of an order is above t exactly if for every gap

    t c_ab < n(Q) - W(Q) < (1 - t) c_ab.                                                    (*)

The fastest order is the path of largest sum of c through all birds: `Bounds.most` finds it in the
manner of Held and Karp. Conditions on the margin concern W(Q), so they are no such path problem;
but given that W(all) is in an interval, u is in one, and n(Q), a parabola of u, in one for each set
Q. The states are the sets Q with their last birds a. `fill_bounds` computes an interval of W(Q) for
each state: from the start of the orders forwards, those that (*) allows for some bird b that
follows, with both ends of the interval of n(Q); then from the end backwards, those of them from
which (*) and the state of Q and b allow to go on. All orders with W(all) and margin as wanted pass
through states within their intervals, so nothing is lost; orders that pass need not be as wanted. A
depth-first search, in lexicographic order, extends orders bird by bird within the intervals. With
the least and the most that the remaining birds can save, it also narrows the interval of u, and
tests (*) for all gaps so far again. If this takes too long, the interval of W(all) is halved, and
both halves are searched with their own, narrower bounds.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import inf, sqrt

import numpy as np
import numpy.typing as npt

from flock_sim.physics.compile import kernel
from flock_sim.theory.arrangement.bounds import (
    Bounds,
    Tables,
    fill_bounds,
    need,
    need_between,
    square_at,
    tables_of,
)
from flock_sim.theory.arrangement.orders import Kinds, OrderArray

MOST_STATES = 2_500_000
"""Largest number of states: that of 17 birds that all differ."""

BUDGET = 200_000
"""Number of begun orders after which an interval is halved."""

GROWTH = 1.1
"""Growth of BUDGET with each halving, since narrower bounds may not help."""

MOST_WORK = 500_000_000
"""Work after which the search gives up, a minute or more: begun orders, and half the states of all
bounds."""

NONE, TIE_FOUND, BETTER_FOUND, STOPPED = 0, 1, 2, 3
"""Results of the search of an interval."""


@dataclass(frozen=True)
class Wanted:
    """The orders that are searched for."""

    margin: float
    """The margin is above this one."""
    saved: float = -inf
    """W(all) is at least this."""
    better_margin: float = -inf
    better_saved: float = -inf
    """An order with more than both ends the search at once."""


class Unfinished(Exception):
    """The search has done MOST_WORK."""


class ChainSearch:
    """The search through the orders of nearest neighbours."""

    def __init__(self, kinds: Kinds) -> None:
        """Prepare tables and bounds of `kinds`, which have no more than MOST_STATES states."""
        self.tables = tables_of(kinds)
        shape = self.tables.placed.shape
        self._bounds = Bounds(*(np.empty(shape) for _ in range(4)))
        fill_bounds(self.tables, self._bounds, -inf, -inf, inf)
        first = self.tables.radix, np.arange(shape[1])
        most = float(self._bounds.most[first].max())
        least = float(self._bounds.least[first].min())
        half = self.tables.cruise_ratio * self.tables.fourths[-1]
        # Below this W(all) no speed balances thrust and drag.
        balanced = self.tables.fourths[-1] - half * half / self.tables.squares[-1]
        self.most_saved = most
        """W(all) of the fastest order."""
        rounding = self.tables.rounding
        self.range = max(least - rounding, float(balanced)), most + rounding
        """Least and largest W(all) of orders that have a speed."""

    def speed(self, saved: float) -> float:
        """Return U* of orders with W(all) = `saved`."""
        tables = self.tables
        return sqrt(square_at(saved, tables.squares[-1], tables.fourths[-1], tables.cruise_ratio))

    def saved_at(self, speed: float) -> float:
        """Return W(all) of orders with the speed `speed`."""
        tables = self.tables
        return need(tables.squares[-1], tables.fourths[-1], speed * speed, tables.cruise_ratio)

    def fastest(self, tie: float) -> OrderArray | None:
        """Return the first order whose speed is within `tie` of the largest; None if none has one.

        It goes from bird to bird where the most that the remaining birds can save is enough.
        """
        if not self.most_saved >= self.range[0]:
            return None
        tables = self.tables
        enough = self.saved_at(self.speed(self.most_saved) - tie)
        fill_bounds(tables, self._bounds, -inf, -inf, inf)
        order: list[int] = []
        now, within = 0, 0.0
        while now < len(tables.squares) - 1:
            for b in np.flatnonzero(tables.placed[now] < tables.counts):
                pair = tables.saved[order[-1], b] if order else 0.0
                then = now + tables.radix[b]
                if (pair or not order) and within + pair + self._bounds.most[then, b] >= enough:
                    break
            order.append(int(b))
            now, within = then, within + pair
        return np.array(order, dtype=np.int8)

    def find(
        self, wanted: Wanted, on_progress: Callable[[float], None]
    ) -> tuple[OrderArray | None, bool]:
        """Return the first wanted order, in lexicographic order, and whether it is a better one.

        The first better order that is found ends the search. `on_progress` is called with the
        fraction of the interval of W(all) that is done. Raises Unfinished.
        """
        bottom, top = max(self.range[0], wanted.saved), self.range[1]
        if not bottom <= top:
            return None, False
        order = np.empty(int(self.tables.counts.sum()), dtype=np.int8)
        rounding = self.tables.rounding
        work, best = 0, None
        intervals = [(bottom, top, float(BUDGET))]
        while intervals:
            low, high, budget = intervals.pop()
            on_progress((top - high) / max(top - bottom, rounding))
            fill_bounds(self.tables, self._bounds, wanted.margin, low, high)
            work += self.tables.placed.size // 2
            result, begun = search(
                self.tables,
                self._bounds,
                (wanted.margin, wanted.better_margin),
                (low, high, wanted.better_saved),
                int(budget),
                order,
            )
            work += begun
            if result == BETTER_FOUND:
                return order, True
            if result == STOPPED:
                if work >= MOST_WORK:
                    raise Unfinished
                middle = 0.5 * (low + high)
                budget *= GROWTH
                intervals += [(low, middle, budget), (middle, high, budget)]
            elif result == TIE_FOUND and (best is None or order.tolist() < best.tolist()):
                best = order.copy()
        return best, False


def states(kinds: Kinds) -> int:
    """Return the number of states of the search: sets of birds times last birds."""
    sets = 1
    for count in kinds.count.tolist():
        sets *= count + 1
    return sets * len(kinds.count)


@kernel
def search(
    tables: Tables,
    bounds: Bounds,
    margins: tuple[float, float],
    interval: tuple[float, float, float],
    budget: int,
    order: OrderArray,
) -> tuple[int, int]:
    """Search one interval of W(all); return the result and the number of begun orders.

    `margins` are the margin and the better margin of `Wanted`, `interval` is the least and the
    largest W(all), and the better one. The function fills `order`, shape (birds,), if one is found.
    """
    count, radix, placed, squares, fourths, saved, ratio, rounding = tables
    low, high, least, most = bounds
    margin, better_margin = margins
    lowest, highest, better_saved = interval
    birds, kinds = len(order), len(count)
    all_squares, all_fourths = squares[-1], fourths[-1]
    kind = np.full(birds + 1, -1)  # at each place, so far
    before = np.zeros(birds + 1, dtype=np.int64)  # the set of birds before each place
    within = np.zeros(birds + 1)  # W of this set
    result, begun, place = NONE, 0, 0
    while place >= 0:
        kind[place] += 1
        b = kind[place]
        if b == kinds:
            kind[place] = -1
            place -= 1
            continue
        if placed[before[place], b] == count[b]:
            continue
        now, total = before[place] + radix[b], within[place]
        if place > 0:
            pair = saved[kind[place - 1], b]
            if pair == 0.0:
                continue
            total += pair
        if not low[now, b] - rounding <= total <= high[now, b] + rounding:
            continue
        fewest = max(lowest, total + least[now, b])
        largest = min(highest, total + most[now, b])
        if fewest > largest + rounding or _is_mirrored(count, placed[now], kind[0], b):
            continue
        begun += 1
        if begun > budget:
            return STOPPED, begun
        before[place + 1], within[place + 1] = now, total
        if place < birds - 1:
            slow = square_at(fewest - rounding, all_squares, all_fourths, ratio)
            fast = square_at(largest + rounding, all_squares, all_fourths, ratio)
            possible = True
            for i in range(place, 0, -1):
                pair = saved[kind[i - 1], kind[i]]
                some, more = need_between(squares[before[i]], fourths[before[i]], slow, fast, ratio)
                if (
                    more - within[i] < margin * pair - rounding
                    or some - within[i] > (1.0 - margin) * pair + rounding
                ):
                    possible = False
                    break
            if possible:
                place += 1
            continue

        if not lowest <= total <= highest:
            continue
        reached = 0.5
        square = square_at(total, all_squares, all_fourths, ratio)
        for i in range(1, birds):
            needed = need(squares[before[i]], fourths[before[i]], square, ratio) - within[i]
            share = needed / saved[kind[i - 1], kind[i]]
            reached = min(reached, share, 1.0 - share)
        if reached > margin:
            order[:] = kind[:birds]
            if reached > better_margin and total > better_saved:
                return BETTER_FOUND, begun
            result = TIE_FOUND
            margin, lowest = max(margin, better_margin), max(lowest, better_saved)
    return result, begun


@kernel
def _is_mirrored(
    count: npt.NDArray[np.int64], placed: npt.NDArray[np.int8], first: int, last: int
) -> bool:
    """Return whether orders that begin with `first` end with a smaller bird: mirror images.

    `placed` are the birds so far, of which `last` is the last one.
    """
    for b in range(len(count) - 1, -1, -1):
        if placed[b] < count[b]:
            return b < first
    return last < first
