# SPDX-License-Identifier: Apache-2.0
"""The orders in which birds can fly side by side, their number, and their speeds and margins.

An order and its mirror image are one formation seen from the left and from the right. They count
once, and stand here as the lexicographically smaller of the two, which begins with the smaller end.
Equal birds are one kind: exchanging them does not make another order.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from math import factorial, prod

import numpy as np
import numpy.typing as npt

from flock_sim.physics.arrays import FloatArray
from flock_sim.physics.compile import kernel
from flock_sim.physics.flock import Flock
from flock_sim.physics.scaling import Scales
from flock_sim.theory.equilibrium import margins

OrderArray = npt.NDArray[np.int8]
"""Kinds of birds in each order, shape (orders, birds)."""

BLOCK = 5000
"""Number of orders that are solved together."""


@dataclass(frozen=True)
class Kinds:
    """The birds of a flock, whatever their order. Arrays have shape (kinds,)."""

    scales: Scales
    coupling: str
    ratio: FloatArray
    """Span ratios, ascending."""
    count: npt.NDArray[np.int64]
    """Number of birds of each span ratio."""

    @classmethod
    def of(cls, scales: Scales, coupling: str, spans: FloatArray) -> Kinds:
        """Return the kinds of birds with the span ratios `spans`, shape (birds,)."""
        ratio, count = np.unique(spans, return_counts=True)
        return cls(scales, coupling, ratio, count.astype(np.int64))

    @property
    def birds(self) -> int:
        """Number N of birds."""
        return int(self.count.sum())

    @cached_property
    def orders(self) -> int:
        """Number of distinct orders: half of all permutations, and half of the palindromes.

        A palindrome is its own mirror image. It needs an even number of birds of every kind but
        one.
        """
        counts = self.count.tolist()
        palindromes = 0
        if sum(count % 2 for count in counts) <= 1:
            palindromes = _permutations([count // 2 for count in counts])
        return (_permutations(counts) + palindromes) // 2

    def all_orders(self) -> OrderArray:
        """Return all distinct orders in lexicographic order, shape (orders, birds)."""
        orders = np.empty((self.orders, self.birds), dtype=np.int8)
        fill_orders(np.repeat(np.arange(len(self.count)), self.count).astype(np.int8), orders)
        return orders

    def values(self, orders: OrderArray) -> tuple[FloatArray, FloatArray]:
        """Return speeds U*, in U_min, and margins of `orders`, both of shape (orders,).

        Both are as in `Equilibrium`: `balanced_speed` and `margin`. They are nan where no speed
        balances thrust and drag, or the vortices of neighbours would meet.
        """
        ratio = np.ascontiguousarray(self.ratio[orders].T)
        square, margin = margins(Flock(self.coupling, self.scales, ratio))
        apart = (ratio[:-1] + ratio[1:] > 1.0).all(axis=0) & np.isfinite(square)
        with np.errstate(invalid="ignore"):
            return np.where(apart, np.sqrt(square), np.nan), np.where(apart, margin, np.nan)

    def values_in_blocks(
        self, orders: OrderArray, on_progress: Callable[[float], None]
    ) -> tuple[FloatArray, FloatArray]:
        """Return the same; `on_progress` is called with the fraction that is done."""
        speed, margin = np.empty(len(orders)), np.empty(len(orders))
        for block in _blocks(len(orders)):
            speed[block], margin[block] = self.values(orders[block])
            on_progress(block.stop / len(orders))
        return speed, margin


def canonical(order: OrderArray) -> OrderArray:
    """Return `order`, shape (birds,), or its mirror image if that is lexicographically smaller."""
    mirrored = order[::-1]
    return order if order.tolist() <= mirrored.tolist() else np.ascontiguousarray(mirrored)


def _permutations(counts: list[int]) -> int:
    """Return the number of permutations of a multiset."""
    return factorial(sum(counts)) // prod(map(factorial, counts))


def _blocks(total: int) -> Iterator[slice]:
    for first in range(0, total, BLOCK):
        yield slice(first, min(total, first + BLOCK))


@kernel
def fill_orders(first: OrderArray, orders: OrderArray) -> None:
    """Fill `orders` with the permutations of `first` that do not exceed their mirror images.

    `first`, shape (birds,), is ascending. The successor of a permutation in lexicographic order
    exchanges the last bird that is followed by a larger one with the last that is larger, and
    reverses the birds after it. Equal birds are never exchanged.
    """
    birds = len(first)
    order = first.copy()
    for k in range(orders.shape[0]):
        while True:
            smaller = True
            for i in range(birds):
                if order[i] != order[birds - 1 - i]:
                    smaller = order[i] < order[birds - 1 - i]
                    break
            if smaller:
                orders[k] = order
            _advance(order)
            if smaller:
                break


@kernel
def _advance(order: OrderArray) -> None:
    """Change `order` into the next permutation; the last one is followed by the first."""
    i = len(order) - 2
    while i >= 0 and order[i] >= order[i + 1]:
        i -= 1
    if i >= 0:
        j = len(order) - 1
        while order[j] <= order[i]:
            j -= 1
        order[i], order[j] = order[j], order[i]
    low, high = i + 1, len(order) - 1
    while low < high:
        order[low], order[high] = order[high], order[low]
        low += 1
        high -= 1
