# SPDX-License-Identifier: Apache-2.0
"""Bounds for the search of the best order of nearest neighbours: see `branch_and_bound`."""

from __future__ import annotations

from math import inf, sqrt
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from flock_sim.physics.arrays import FloatArray
from flock_sim.physics.compile import kernel
from flock_sim.physics.formation import TIP_SPACING, VORTEX_FRACTION
from flock_sim.physics.interaction import even_part
from flock_sim.theory.arrangement.orders import Kinds

ROUNDING = 1e-13
"""Bound of the rounding errors of W and n, relative to the largest W(all)."""


class Tables(NamedTuple):
    """What the kernels need about the birds. A set of birds is a number in a mixed radix."""

    counts: npt.NDArray[np.int64]
    radix: npt.NDArray[np.int64]
    placed: npt.NDArray[np.int8]
    """Number of birds of each kind in each set, shape (sets, kinds)."""
    squares: FloatArray
    """Sum of lambda^2 of each set."""
    fourths: FloatArray
    saved: FloatArray
    """c_ab of each pair of kinds, shape (kinds, kinds); 0 where their vortices would meet."""
    cruise_ratio: float
    rounding: float
    """Bound of the rounding errors of W and n."""


class Bounds(NamedTuple):
    """The bounds of each state, shape (sets, kinds)."""

    low: FloatArray
    """Least W(Q) with which an order can be wanted; above `high` if none can."""
    high: FloatArray
    least: FloatArray
    """Least sum of c that later neighbours can add."""
    most: FloatArray


def tables_of(kinds: Kinds) -> Tables:
    """Return the tables of `kinds`."""
    sizes = kinds.count + 1
    sets = int(np.prod(sizes))
    radix = np.concatenate([[1], np.cumprod(sizes[:-1])]).astype(np.int64)
    placed = (np.arange(sets)[:, np.newaxis] // radix % sizes).astype(np.int8)
    square = kinds.ratio * kinds.ratio
    saved = np.zeros((len(sizes), len(sizes)))
    for a, one in enumerate(kinds.ratio.tolist()):
        for b, other in enumerate(kinds.ratio.tolist()):
            if one + other > 1.0:
                lateral = one + other + TIP_SPACING
                even = even_part(lateral, VORTEX_FRACTION * one, VORTEX_FRACTION * other)
                saved[a, b] = -kinds.scales.saving_ratio * square[a] * square[b] * even
    return Tables(
        kinds.count,
        radix,
        placed,
        placed @ square,
        placed @ (square * square),
        saved,
        kinds.scales.cruise_ratio,
        ROUNDING * kinds.birds * float(saved.max()),
    )


@kernel
def square_at(saved: float, squares: float, fourths: float, cruise_ratio: float) -> float:
    """Return u of W(all) = `saved`: `steady_square`, with its least value below that of any u."""
    half = cruise_ratio * fourths
    return (half + sqrt(max(0.0, half * half - squares * (fourths - saved)))) / squares


@kernel
def need(squares: float, fourths: float, square: float, cruise_ratio: float) -> float:
    """Return n of a set of birds at u = `square`."""
    return (squares * square - 2.0 * cruise_ratio * fourths) * square + fourths


@kernel
def need_between(
    squares: float, fourths: float, low: float, high: float, cruise_ratio: float
) -> tuple[float, float]:
    """Return the least and the largest n of a set of birds for u in [low, high]."""
    ends = need(squares, fourths, low, cruise_ratio), need(squares, fourths, high, cruise_ratio)
    lowest = cruise_ratio * fourths / squares
    if low < lowest < high:
        return need(squares, fourths, lowest, cruise_ratio), max(ends)
    return min(ends), max(ends)


@kernel
def fill_bounds(
    tables: Tables, bounds: Bounds, margin: float, lowest: float, highest: float
) -> None:
    """Fill the bounds of all states, for margins above `margin` and W(all) in [lowest, highest]."""
    count, radix, placed, squares, fourths, saved, ratio, rounding = tables
    low, high, least, most = bounds
    sets, kinds = placed.shape
    slow = square_at(lowest, squares[-1], fourths[-1], ratio) if lowest > -inf else 0.0
    fast = square_at(highest, squares[-1], fourths[-1], ratio) if highest < inf else 0.0
    _fill_reached(tables, bounds, margin, slow, fast)
    least[:], most[:] = inf, -inf
    low[-1], high[-1] = np.maximum(low[-1], lowest), np.minimum(high[-1], highest)
    least[-1], most[-1] = 0.0, 0.0
    for now in range(sets - 2, 0, -1):
        fewest, largest = need_between(squares[now], fourths[now], slow, fast, ratio)
        for a in range(kinds):
            reached_low, reached_high = low[now, a], high[now, a]
            low[now, a], high[now, a] = inf, -inf
            if reached_low > reached_high:
                continue
            for b in range(kinds):
                pair = saved[a, b]
                if placed[now, b] == count[b] or pair == 0.0:
                    continue
                then = now + radix[b]
                lower = max(reached_low, low[then, b] - pair)
                upper = min(reached_high, high[then, b] - pair)
                if margin > -inf:
                    lower = max(lower, fewest - (1.0 - margin) * pair)
                    upper = min(upper, largest - margin * pair)
                if lower <= upper + rounding:
                    low[now, a] = min(low[now, a], lower, upper)
                    high[now, a] = max(high[now, a], lower, upper)
                    least[now, a] = min(least[now, a], pair + least[then, b])
                    most[now, a] = max(most[now, a], pair + most[then, b])


@kernel
def _fill_reached(tables: Tables, bounds: Bounds, margin: float, slow: float, fast: float) -> None:
    """Fill `low` and `high` with the W(Q) with which orders can reach each state from their start.

    U*^2 is in [`slow`, `fast`].
    """
    count, radix, placed, squares, fourths, saved, ratio, rounding = tables
    low, high, _, _ = bounds
    sets, kinds = placed.shape
    low[:], high[:] = inf, -inf
    for b in range(kinds):
        low[radix[b], b] = high[radix[b], b] = 0.0
    for now in range(1, sets - 1):
        fewest, largest = need_between(squares[now], fourths[now], slow, fast, ratio)
        for a in range(kinds):
            if low[now, a] > high[now, a]:
                continue
            for b in range(kinds):
                pair = saved[a, b]
                if placed[now, b] == count[b] or pair == 0.0:
                    continue
                lower, upper = low[now, a], high[now, a]
                if margin > -inf:
                    lower = max(lower, fewest - (1.0 - margin) * pair)
                    upper = min(upper, largest - margin * pair)
                if lower <= upper + rounding:
                    then = now + radix[b]
                    low[then, b] = min(low[then, b], lower + pair, upper + pair)
                    high[then, b] = max(high[then, b], lower + pair, upper + pair)
