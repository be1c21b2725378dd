# SPDX-License-Identifier: Apache-2.0
"""The best order of unequal birds: the fastest, the fastest that holds together, the firmest.

Up to MOST_COUNTED orders, all are computed. Beyond, nearest neighbours are searched by branch and
bound (`branch_and_bound`), exactly too; other flocks by a local search (`local_search`),
which is a heuristic.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from flock_sim.physics.arrays import FloatArray
from flock_sim.physics.scaling import Scales, drag_reduction
from flock_sim.theory.arrangement.branch_and_bound import (
    MOST_STATES,
    ChainSearch,
    Unfinished,
    Wanted,
    states,
)
from flock_sim.theory.arrangement.local_search import (
    LocalSearch,
    Objective,
    fastest,
    fastest_flying,
    firmest,
)
from flock_sim.theory.arrangement.orders import Kinds, OrderArray, canonical
from flock_sim.theory.steady_speed import balances

if TYPE_CHECKING:
    from flock_sim.configuration.flock_configuration import FlockConfiguration

TIE = 1e-12
"""Largest difference of speeds, in U_min, or of margins that counts as rounding.

Of such orders, the result is the lexicographically smallest.
"""

MOST_COUNTED = 2_000_000
"""Largest number of orders that are all computed: that of ten birds that all differ, and a few."""

STARTS = 16
"""Starts of a local search, for few birds."""

WORK = 2e8
"""Work of a local search: pairs of birds in all orders that it tries, about 2 N^3 a start.

With all-to-all coupling, the worst sets cost as much as N / 8 times as many pairs. Large flocks
have fewer starts.
"""

EXACT, ALL_ORDERS, BOUNDED, HEURISTIC = "exact", "all orders", "branch and bound", "local search"
"""Methods: "exact" for results that are proven, and how they are found."""

OnProgress = Callable[[str, float], None]


@dataclass(frozen=True)
class Arranged:
    """An order, and its steady state."""

    order: FloatArray
    """Span ratios, with the smaller end first, shape (birds,)."""
    speed: float
    """U*, in U_min: the speed at which all forces sum to 0, whether the order can fly or not."""
    margin: float
    """As `Equilibrium.margin`; above 0 exactly if the order can fly."""
    saving: float
    """Mean drag reduction of its birds; nan if the order can't fly."""
    proven: bool
    """Whether no other order is better."""

    @property
    def flies(self) -> bool:
        """Whether the order has a steady state."""
        return self.margin > 0.0


@dataclass(frozen=True)
class Arrangement:
    """The best orders of some birds."""

    kinds: Kinds
    orders: int
    """Number of distinct orders. Mirror images count once, and so do exchanged equal birds."""
    flying: int | None
    """Number of orders that have a steady state; None if they were not counted."""
    fastest: Arranged | None
    """The order of the largest U*; None if no order has one."""
    fastest_flying: Arranged | None
    """The fastest order that has a steady state; None if none has, or none was found."""
    firmest: Arranged | None
    """The order of the largest margin; None if none has a steady state, or none was found."""
    closest: Arranged | None
    """The order of the largest margin where none has a steady state, or none was found."""
    algorithm: str
    """ALL_ORDERS, BOUNDED or HEURISTIC."""
    speed: FloatArray | None
    """U* of all orders, shape (orders,), in lexicographic order; None if they were not computed."""
    margin: FloatArray | None

    @property
    def method(self) -> str:
        """EXACT if all results are proven, otherwise HEURISTIC."""
        results = (self.fastest, self.fastest_flying, self.firmest, self.closest)
        proven = all(each.proven for each in results if each is not None)
        return EXACT if proven and self.algorithm != HEURISTIC else HEURISTIC


def arrange(
    configuration: FlockConfiguration,
    spans: FloatArray,
    on_progress: OnProgress = lambda what, done: None,
) -> Arrangement:
    """Return the best orders of birds with the span ratios `spans`, shape (birds,).

    Coupling and standard bird are those of `configuration`, whose own birds do not matter.
    `on_progress` is called with what is being done, and with the fraction of it that is done.
    """
    coupling = configuration.coupling
    kinds = Kinds.of(Scales.of(configuration), coupling, spans)
    if kinds.orders <= MOST_COUNTED:
        return _counted(kinds, on_progress)
    algorithm = HEURISTIC
    if coupling == "nearest" and states(kinds) <= MOST_STATES:
        algorithm = BOUNDED
    search = _Search(kinds, algorithm, on_progress)
    quick = search.quickest()
    firm = search.firmest()
    return Arrangement(
        kinds,
        kinds.orders,
        None,
        quick,
        quick if quick is not None and quick.flies else search.fastest_flying(firm),
        firm if firm is not None and firm.flies else None,
        firm if firm is not None and not firm.flies else None,
        algorithm,
        None,
        None,
    )


def arranged(kinds: Kinds, order: OrderArray, proven: bool) -> Arranged | None:
    """Return the result for `order`, shape (birds,); None if it has no speed."""
    order = canonical(order)
    speed, margin = (float(values[0]) for values in kinds.values(order[np.newaxis]))
    if np.isnan(speed):
        return None
    ratio = kinds.ratio[order]
    needed = balances(ratio, speed * speed, kinds.scales.cruise_ratio)
    saved = drag_reduction(needed, 2.0 * kinds.scales.cruise_ratio)
    saving = float(saved.mean()) if margin > 0.0 else np.nan
    return Arranged(ratio, speed, margin, saving, proven)


def _counted(kinds: Kinds, on_progress: OnProgress) -> Arrangement:
    """Return the best of all orders."""
    orders = kinds.all_orders()
    speed, margin = kinds.values_in_blocks(orders, lambda done: on_progress("all orders", done))
    flies = margin > 0.0
    firm = _first_best(kinds, orders, margin)
    return Arrangement(
        kinds,
        len(orders),
        int(flies.sum()),
        _first_best(kinds, orders, speed),
        _first_best(kinds, orders, np.where(flies, speed, np.nan)),
        firm if flies.any() else None,
        None if flies.any() else firm,
        ALL_ORDERS,
        speed,
        margin,
    )


def _first_best(kinds: Kinds, orders: OrderArray, value: FloatArray) -> Arranged | None:
    """Return the first order of the largest value, apart from rounding; None if all are nan."""
    if np.isnan(value).all():
        return None
    first = int(np.argmax(value >= np.nanmax(value) - TIE))
    return arranged(kinds, orders[first], proven=True)


class _Search:
    """The search for the best orders where they are too many to compute all."""

    def __init__(self, kinds: Kinds, algorithm: str, on_progress: OnProgress) -> None:
        self._kinds = kinds
        self._on_progress = on_progress
        self._local = LocalSearch(kinds)
        self._exact = ChainSearch(kinds) if algorithm == BOUNDED else None
        pairs = kinds.birds - 1
        if kinds.coupling == "all":
            pairs = kinds.birds * pairs // 2 * max(8, kinds.birds) // 8
        self._starts = int(np.clip(WORK / (2.0 * kinds.birds**3 * pairs), 1, STARTS))

    def quickest(self) -> Arranged | None:
        """Return the fastest order."""
        if self._exact is None:
            return arranged(self._kinds, self._best("fastest", fastest, []), proven=False)
        order = self._exact.fastest(TIE)
        return None if order is None else arranged(self._kinds, order, proven=True)

    def firmest(self) -> Arranged | None:
        """Return the order of the largest margin, whether it can fly or not."""

        def wanted(found: Arranged) -> Wanted:
            return Wanted(found.margin - TIE, better_margin=found.margin + TIE)

        return self._proven("firmest", firmest, [], wanted)

    def fastest_flying(self, firm: Arranged | None) -> Arranged | None:
        """Return the fastest order that can fly; `firm` is the order of the largest margin."""
        if firm is None or not firm.flies:
            return None

        def wanted(found: Arranged) -> Wanted:
            assert self._exact is not None
            least, better = (self._exact.saved_at(found.speed + side * TIE) for side in (-1, 1))
            return Wanted(0.0, least, better_saved=better)

        flying = np.searchsorted(self._kinds.ratio, firm.order).astype(np.int8)
        return self._proven("fastest that flies", fastest_flying, [flying], wanted)

    def _best(self, what: str, objective: Objective, given: list[OrderArray]) -> OrderArray:
        return self._local.best(
            objective, self._starts, given, lambda done: self._on_progress(f"{what}: search", done)
        )

    def _proven(
        self,
        what: str,
        objective: Objective,
        given: list[OrderArray],
        wanted: Callable[[Arranged], Wanted],
    ) -> Arranged | None:
        """Return the order that a local search finds, or a better one if there is any.

        The search starts from `given` orders, too. `wanted` returns what is as good as an order.
        """
        order = self._best(what, objective, given)
        found = arranged(self._kinds, order, proven=False)
        if self._exact is None or found is None:
            return found
        try:
            while True:
                first, better = self._exact.find(
                    wanted(found), lambda done: self._on_progress(f"{what}: proof", done)
                )
                if first is None:
                    first = order
                elif better:
                    first = self._local.improved(first, objective)
                following = arranged(self._kinds, first, proven=not better)
                if not better or following is None:
                    return following
                order, found = first, following
        except Unfinished:
            return found
