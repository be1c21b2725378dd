# SPDX-License-Identifier: Apache-2.0
"""A local search for the best order: a heuristic, which also gives the exact search its start.

From each of several random orders, the search goes to the best of all orders that one change makes
(two birds exchanged, a row of birds reversed, or one bird moved), until none of them is better.
The random numbers have a fixed seed, so equal birds give equal results.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from flock_sim.physics.arrays import FloatArray, IntArray
from flock_sim.theory.arrangement.orders import Kinds, OrderArray, canonical

SEED = 20

GAIN = 1e-13
"""Least gain of a change that is more than rounding."""

Objective = Callable[[FloatArray, FloatArray], FloatArray]
"""What is searched for: a function of speeds and margins that is to be as large as possible."""


def fastest(speed: FloatArray, margin: FloatArray) -> FloatArray:
    """Return the speed."""
    return speed


def fastest_flying(speed: FloatArray, margin: FloatArray) -> FloatArray:
    """Return the margin of orders that can't fly, and more than any of them for those that can."""
    return np.where(margin > 0.0, 1.0 + speed, margin)


def firmest(speed: FloatArray, margin: FloatArray) -> FloatArray:
    """Return the margin."""
    return margin


class LocalSearch:
    """The local search for the best orders of some birds."""

    def __init__(self, kinds: Kinds) -> None:
        """Prepare the changes of an order of `kinds`."""
        self.kinds = kinds
        self._changes = changes(kinds.birds)

    def best(
        self,
        objective: Objective,
        starts: int,
        given: Sequence[OrderArray],
        on_progress: Callable[[float], None],
    ) -> OrderArray:
        """Return the best order that is found from `starts` random orders and those `given`.

        Of orders that differ by rounding only, it is the lexicographically smallest. `on_progress`
        is called with the fraction that is done.
        """
        random = np.random.default_rng(SEED)
        birds = np.repeat(np.arange(len(self.kinds.count)), self.kinds.count).astype(np.int8)
        begins = [*given, *(random.permutation(birds) for _ in range(starts))]
        found = []
        for number, order in enumerate(begins, 1):
            found.append(canonical(self.improved(order, objective)))
            on_progress(number / len(begins))
        value = self._values(np.array(found), objective)
        return min(
            (order for order, of in zip(found, value, strict=True) if of >= value.max() - GAIN),
            key=lambda order: order.tolist(),
        )

    def improved(self, order: OrderArray, objective: Objective) -> OrderArray:
        """Return the order to which the best changes lead from `order`, shape (birds,)."""
        reached = self._values(order[np.newaxis], objective)[0]
        while True:
            tried = order[self._changes]
            value = self._values(tried, objective)
            best = int(np.argmax(value))
            if not value[best] > reached + GAIN:
                return order
            order, reached = tried[best], value[best]

    def _values(self, orders: OrderArray, objective: Objective) -> FloatArray:
        value = objective(*self.kinds.values(orders))
        return np.where(np.isnan(value), -np.inf, value)


def changes(birds: int) -> IntArray:
    """Return the changes of an order as permutations of places, shape (changes, birds)."""
    places = list(range(birds))
    made = {tuple(places)}
    for i in range(birds):
        for j in range(i + 1, birds):
            swapped = places.copy()
            swapped[i], swapped[j] = j, i
            moved_up = places[:i] + places[i + 1 : j + 1] + [i] + places[j + 1 :]
            moved_down = places[:i] + [j] + places[i:j] + places[j + 1 :]
            reversed_row = places[:i] + places[i : j + 1][::-1] + places[j + 1 :]
            made |= {tuple(each) for each in (swapped, moved_up, moved_down, reversed_row)}
    return np.array(sorted(made), dtype=np.int64)
