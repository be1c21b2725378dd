# SPDX-License-Identifier: Apache-2.0
"""The steady state of nearest-neighbour coupling in which birds see each other with a constant lag.

Bird j computes its drag from the state of bird i one lag tau ago: position x_i(t - tau) and
circulation. In steady flight the circulation is constant, and the seen position is d = U* tau
behind the true one, for both birds of a pair. The share s(x) = I(x) / (2 E) grows from 0 far ahead
of the source to 1 far behind it, with s(x) + s(-x) = 1. So the birds on either side of a gap
g = x_{i+1} - x_i get

    D_{i+1,i} / C_i = s(g - d),    D_{i,i+1} / C_i = s(-g - d) = 1 - s(g + d)

of the saving of the pair without a lag. The sum of both is less than 1, by an amount that depends
on the gap, so the sum of all balances no longer gives U*. But at a trial speed the need of the last
bird of a wing still fixes its gap, the gap fixes the share of the next bird, and so on from either
end of the flock to the leader (or to any other bird). The balance of this bird is one equation for
u = U^2. As u grows, outer birds need more and leave less to inner ones, so the equation has one
root, which is found by bisection.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, isnan, nan, sqrt

import numpy as np
import numpy.typing as npt

from flock_sim.errors import RunFailed
from flock_sim.physics.aerodynamics import ahead_integral, even_part, split_drag
from flock_sim.physics.arrays import FloatArray
from flock_sim.physics.compile import kernel
from flock_sim.physics.flock import Flock
from flock_sim.physics.formation import TIP_SPACING, VORTEX_FRACTION
from flock_sim.theory.nearest import gap_of_share
from flock_sim.theory.steady_speed import balance

BALANCED = 1e-11
"""Largest remaining force, times u / k, that is rounding: pairs save about 0.5."""


@dataclass(frozen=True)
class DelayedNearest:
    """The steady states of an ensemble at a constant lag; nan if none exists."""

    exists: npt.NDArray[np.bool_]
    """Whether the flock can fly in formation, shape (members,)."""
    speed: FloatArray
    """U*, shape (members,), in U_min."""
    spacing: FloatArray
    """True x_{i+1} - x_i, shape (birds - 1, members), in b."""
    tail_share: FloatArray
    """D_{i+1,i} / C_i, the share of the bird before gap i, shape (birds - 1, members).

    All are in (0, 1) if a formation exists; otherwise at least one share is not.
    """
    head_share: FloatArray
    """D_{i,i+1} / C_i, the share of the bird after gap i, shape (birds - 1, members)."""
    margin: FloatArray
    """Least distance of an outer bird's share from 0 or 1, shape (members,).

    0 or less if no formation exists; inf for a bird alone, nan if no speed is found.
    """


def delayed_nearest(flock: Flock, lag: FloatArray | float) -> DelayedNearest:
    """Return the steady states of all members of `flock` if birds see neighbours `lag` late.

    `lag` is tau >= 0 in b / U_min, a number or of shape (members,). Seen positions are held; with
    extrapolation at their speed, a steady flock is the same as without a lag (see `equilibrium`).
    Solutions have u >= H_0 lambda^2 for every bird: then each bird needs more saving at a higher
    speed. If the largest bird can cruise alone, other solutions exist only on the unstable branch
    below U_min.

    Raises ValueError for all-to-all coupling, which has no chain of gaps, and for a lag that is
    negative or not finite. Raises RunFailed if rounding hides the state: this needs a large lag and
    birds so different that some wing falls back and comes forward again.
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
    with np.errstate(over="ignore", invalid="ignore"):  # a member that overflows is nan
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
            f"saves is left over, at lag {lags[m]:g}; use a smaller lag, or more similar birds"
        )
    exists = margin > 0.0
    spacing[:, ~exists] = nan
    return DelayedNearest(
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
    """Fill U*^2, margins and the remaining force `rest`, each (members,), and the gaps' values.

    The two chains meet at the leader. If the remaining force is too large there, they meet at the
    bird with the least remaining force: rounding errors shrink from a bird to one ahead of it, and
    grow to one behind.
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
    """Return u at which all birds are in balance, to the last bit; nan if there is none."""
    low: float = cruise_ratio * ratios.max() ** 2
    if not (_left_over(ratios, head, low, lag, cruise_ratio, strength, seen, outer, inner) >= 0.0):
        return nan
    high = 2.0 * low
    # Drag grows with u and savings do not, so the loop ends.
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

    It falls with u = `square`. The function fills, for each gap, the distance `seen` by which the
    outer bird sees the inner one ahead, and both shares, `outer` and `inner`. If no gap gives the
    outer share, the inner share is the limit of such gaps: 1 for an outer share of 0 or less, and 0
    for 1 or more.
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
    """Return s(x) = I(x) / (2 E) of a bird that sees the other at `x` ahead; `even` is E."""
    ahead = ahead_integral(abs(x), lateral, half, other_half)
    return split_drag(x, 1.0, ahead, even)[0] / (2.0 * even)
