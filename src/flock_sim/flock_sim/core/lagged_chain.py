# SPDX-License-Identifier: Apache-2.0
"""The steady state of nearest-neighbour coupling where birds see each other a constant lag late.

Bird j feels what bird i was a lag tau ago: its position x_i(t - tau) and its circulation. In steady
flight the circulation is still that, and the position is d = U* tau behind where the bird is, for
both birds of a pair. With the share s(x) = I(x) / (2 E), which grows from 0 far ahead of the source
to 1 far behind it, s(x) + s(-x) = 1, the birds on either side of a gap g = x_{i+1} - x_i get

    D_{i+1,i} / C_i = s(g - d),    D_{i,i+1} / C_i = s(-g - d) = 1 - s(g + d)

of what the pair would save without a lag. Both together get less than 1, and how much less depends
on the gap: the sum of all balances no longer gives U*. But at a trial speed what the last bird of a
wing needs still fixes its gap, the gap fixes what the next bird gets of it, and so on from either
end of the flock to the leader (or to any other bird), whose balance is one equation for u = U^2.
What outer birds need grows with u and what they leave to inner ones falls, so its one root is found
by bisection.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, isnan, nan, sqrt

import numpy as np
import numpy.typing as npt

from flock_sim.core.aerodynamics import ahead_integral, even_part
from flock_sim.core.chain import gap_of_share
from flock_sim.core.flock import Flock
from flock_sim.core.formation import TIP_SPACING, VORTEX_FRACTION
from flock_sim.core.kernel import FloatArray, kernel
from flock_sim.core.steady_speed import balance
from flock_sim.errors import RunFailed

BALANCED = 1e-11
"""Force left over, times u / k, below which all is rounding: pairs save some 0.5."""


@dataclass(frozen=True)
class LaggedChain:
    """The steady states of an ensemble at a constant lag; nan where there is none."""

    exists: npt.NDArray[np.bool_]
    """Whether the flock can fly in formation, shape (members,)."""
    speed: FloatArray
    """U*, shape (members,), in U_min."""
    spacing: FloatArray
    """True x_{i+1} - x_i, shape (birds - 1, members), in b."""
    tail_share: FloatArray
    """D_{i+1,i} / C_i, what the bird before gap i gets, shape (birds - 1, members).

    In (0, 1) where a formation exists; where none does, one of them is not.
    """
    head_share: FloatArray
    """D_{i,i+1} / C_i, what the bird after gap i gets, shape (birds - 1, members)."""
    margin: FloatArray
    """Least distance of an outer bird's share from 0 or 1, shape (members,).

    Not above 0 where no formation exists; inf for a bird alone, nan where no speed is found.
    """


def lagged_chain(flock: Flock, lag: FloatArray | float) -> LaggedChain:
    """Return the steady states of all members of `flock` that see their neighbours `lag` late.

    `lag` is tau >= 0 in b / U_min, a number or of shape (members,). Neighbours are held where they
    were; where they are moved on at their speed a steady flock sees no lag (see `equilibrium`).
    Solutions are those with u >= H_0 lambda^2 for every bird, where each needs the more drag saved
    the faster it flies; a largest bird that can cruise alone rules out others but for flight on
    the unstable branch below U_min.

    Raises ValueError for all-to-all coupling, where gaps don't follow one from another, and for a
    lag that is negative or not finite; RunFailed where rounding hides the state, which takes a
    large lag and birds so different that some wing falls back and comes forward again.
    """
    if flock.coupling != "nearest" and flock.birds > 1:
        raise ValueError("only nearest-neighbour coupling makes a chain")
    lags = np.ascontiguousarray(np.broadcast_to(np.asarray(lag, dtype=np.float64), flock.members))
    if not np.all((lags >= 0.0) & (lags < np.inf)):
        raise ValueError("lag must be finite and 0 or more")
    gaps, members = flock.birds - 1, flock.members
    square, margin, rest = (np.empty(members) for _ in range(3))
    spacing, tail_share, head_share = (np.empty((gaps, members)) for _ in range(3))
    scales = flock.scales
    with np.errstate(over="ignore", invalid="ignore"):  # a member beyond all numbers is nan
        _fill_states(
            flock.span_ratio,
            lags,
            scales.cruise_ratio,
            scales.saving_ratio,
            square,
            spacing,
            tail_share,
            head_share,
            margin,
            rest,
        )
    unbalanced = np.flatnonzero(rest > BALANCED)
    if len(unbalanced):
        m = unbalanced[0]
        raise RunFailed(
            f"member {m + 1}: rounding grows along its chain until {rest[m]:.2g} of what a pair "
            f"saves is left over, at lag {lags[m]:g}; a smaller lag, or birds more alike, would do"
        )
    exists = margin > 0.0
    spacing[:, ~exists] = nan
    return LaggedChain(
        exists=exists,
        speed=np.sqrt(np.where(exists, square, nan)),
        spacing=spacing,
        tail_share=tail_share,
        head_share=head_share,
        margin=margin,
    )


@kernel
def _fill_states(
    span_ratio: FloatArray,
    lag: FloatArray,
    cruise_ratio: float,
    strength: float,
    square: FloatArray,
    spacing: FloatArray,
    tail_share: FloatArray,
    head_share: FloatArray,
    margin: FloatArray,
    rest: FloatArray,
) -> None:
    """Fill U*^2, margins, and what force is `rest`, each (members,), and the gaps' numbers.

    The wings meet at the leader, or where that leaves too much at the bird that leaves least: what
    is rounded shrinks from each bird to one ahead of it, and grows to one behind.
    """
    birds, members = span_ratio.shape
    for m in range(members):
        ratios = span_ratio[:, m].copy()
        seen, outer, inner = np.empty(birds - 1), np.empty(birds - 1), np.empty(birds - 1)
        best = inf
        for trial in range(birds):
            # The leader, and then the others on its left and right.
            step = (trial + 1) // 2
            head = birds // 2 + (-step if trial % 2 else step)
            if head >= birds:
                head = 0
            u = _balanced_square(ratios, head, lag[m], cruise_ratio, strength, seen, outer, inner)
            left = abs(
                _left_over(ratios, head, u, lag[m], cruise_ratio, strength, seen, outer, inner)
            )
            if trial == 0 or left < best:
                best = left
                square[m] = u
                margin[m] = nan if isnan(u) else inf
                for gap in range(birds - 1):
                    ahead = seen[gap] + sqrt(u) * lag[m]
                    left_wing = gap < head
                    spacing[gap, m] = ahead if left_wing else -ahead
                    tail_share[gap, m] = outer[gap] if left_wing else inner[gap]
                    head_share[gap, m] = inner[gap] if left_wing else outer[gap]
                    margin[m] = min(margin[m], outer[gap], 1.0 - outer[gap])
            if not best > BALANCED:
                break
        rest[m] = best


@kernel
def _balanced_square(
    ratios: FloatArray,
    head: int,
    lag: float,
    cruise_ratio: float,
    strength: float,
    seen: FloatArray,
    outer: FloatArray,
    inner: FloatArray,
) -> float:
    """Return u at which all birds are in balance, to the last bit; nan where none is."""
    low: float = cruise_ratio * ratios.max() ** 2
    if not (_left_over(ratios, head, low, lag, cruise_ratio, strength, seen, outer, inner) >= 0.0):
        return nan
    high = 2.0 * low
    # Drag grows with u, savings don't: this ends.
    while (
        high < inf
        and _left_over(ratios, head, high, lag, cruise_ratio, strength, seen, outer, inner) > 0.0
    ):
        low, high = high, 2.0 * high
    u: float = 0.5 * (low + high)
    while low < u < high:
        if _left_over(ratios, head, u, lag, cruise_ratio, strength, seen, outer, inner) > 0.0:
            low = u
        else:
            high = u
        u = 0.5 * (low + high)
    return u


@kernel
def _left_over(
    ratios: FloatArray,
    head: int,
    square: float,
    lag: float,
    cruise_ratio: float,
    strength: float,
    seen: FloatArray,
    outer: FloatArray,
    inner: FloatArray,
) -> float:
    """Return the force left on bird `head`, times u / k, when all others are in balance at u.

    Falls with u = `square`. Filled are, for each gap, how far ahead the outer bird sees the inner
    one, and their shares; a share that no gap gives leaves the inner bird 1 where it is 0 or less,
    and 0 where it is 1 or more, as the gaps that come near it do.
    """
    birds = len(ratios)
    twice = 2.0 * sqrt(square) * lag
    left = square * balance(ratios[head], square, cruise_ratio)
    for side in range(2):
        first, step = (0, 1) if side == 0 else (birds - 1, -1)
        given = 0.0
        for k in range(abs(head - first)):
            bird = first + step * k
            gap = bird if side == 0 else bird - 1
            one, other = ratios[bird], ratios[bird + step]
            half, other_half = VORTEX_FRACTION * one, VORTEX_FRACTION * other
            lateral = one + other + TIP_SPACING
            even = even_part(lateral, half, other_half)
            pair = strength * (one * other) ** 2 * even
            share = (square * balance(one, square, cruise_ratio) - given) / pair
            ahead = gap_of_share(share, lateral, half, other_half)
            if share <= 0.0:
                rest = 1.0
            elif share >= 1.0:
                rest = 0.0
            else:
                rest = _share_at(-(ahead + twice), lateral, half, other_half, even)
            seen[gap] = ahead
            outer[gap] = share
            inner[gap] = rest
            given = pair * rest
        left -= given
    return left


@kernel
def _share_at(x: float, lateral: float, half: float, other_half: float, even: float) -> float:
    """Return s(x) = I(x) / (2 E) of a bird that sees the other `x` ahead; `even` is E."""
    smaller = ahead_integral(abs(x), lateral, half, other_half) / (2.0 * even)
    return 1.0 - smaller if x > 0.0 else smaller
