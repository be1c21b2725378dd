# SPDX-License-Identifier: Apache-2.0
"""The exact steady state of nearest-neighbour coupling, for any span ratios.

At the common speed U* (see `steady_speed`), the saving that bird 1 needs fixes D_21. The rest of
the pair's constant sum C_1 is D_12. Then the saving that bird 2 needs fixes D_32, and so on along
the chain. The share of gap i,

    s_i = D_{i+1,i} / C_i = (sum_{j <= i} R_j - sum_{l < i} C_l) / C_i,    R_j = T_j - D_j(U*),

is the part of birds 1..i in the saving of the pair across the gap. It is 1/2 side by side. It goes
towards 1 as bird i falls behind, and towards 0 as bird i + 1 falls behind. So a formation exists if
all shares lie in (0, 1), and each gap follows from one equation, f(|x|) = 2 E min(s, 1 - s).
"""

from math import inf, nan, sqrt

from flock_sim.physics.aerodynamics import ahead_integral_and_slope, even_part
from flock_sim.physics.arrays import FloatArray
from flock_sim.physics.compile import kernel
from flock_sim.physics.formation import TIP_SPACING, VORTEX_FRACTION
from flock_sim.theory.steady_speed import balance, steady_square

MOST_ITERATIONS = 100
"""Most iterations for a gap. No gap needs so many: bisection alone would need some 60."""

LAST_STEP = 1e-9
"""Relative size of the last step for a gap: the next step would be of the order of its square."""


@kernel
def fill_shares(
    span_ratio: FloatArray,
    thrust_ratio: FloatArray,
    cruise_ratio: float,
    strength: float,
    square: FloatArray,
    share: FloatArray,
) -> None:
    """Fill U*^2, `square` (members,), and the shares of the gaps, `share` (birds - 1, members).

    `span_ratio` and `thrust_ratio` have shape (birds, members); `cruise_ratio` is H_0, `strength`
    4 e_O / pi^2.
    Shares outside of (0, 1) mean that no formation exists. All are nan if no speed exists.
    """
    birds, members = span_ratio.shape
    for m in range(members):
        squares, fourths, saving, added = 0.0, 0.0, 0.0, 0.0
        before = 0.0
        for i in range(birds):
            ratio = span_ratio[i, m] * span_ratio[i, m]
            squares += ratio
            fourths += ratio * ratio
            added += ratio * ratio * (thrust_ratio[i, m] - 1.0)
            if i > 0:
                share[i - 1, m] = strength * before * ratio * _even(span_ratio, i - 1, m)
                saving += share[i - 1, m]
            before = ratio
        u = steady_square(squares, fourths, saving, cruise_ratio, added)
        square[m] = u
        carried = 0.0
        for i in range(birds - 1):
            pair = share[i, m] / u
            carried += balance(span_ratio[i, m], u, cruise_ratio * thrust_ratio[i, m])
            share[i, m] = carried / pair
            carried -= pair


@kernel
def fill_spacings(span_ratio: FloatArray, share: FloatArray, spacing: FloatArray) -> None:
    """Fill `spacing`, x_{i+1} - x_i of shape (birds - 1, members) in b, from the shares.

    A spacing is nan if its share is not in (0, 1).
    """
    birds, members = span_ratio.shape
    for m in range(members):
        for i in range(birds - 1):
            half = VORTEX_FRACTION * span_ratio[i, m]
            other = VORTEX_FRACTION * span_ratio[i + 1, m]
            lateral = span_ratio[i, m] + span_ratio[i + 1, m] + TIP_SPACING
            spacing[i, m] = gap_of_share(share[i, m], lateral, half, other)


@kernel
def gap_of_share(share: float, lateral: float, half: float, other_half: float) -> float:
    """Return the streamwise distance, in b, at which a bird gets `share` of the pair's saving.

    It is positive if the bird is behind the other; nan if `share` is not in (0, 1). `lateral`,
    `half` and `other_half` are as for `ahead_integral`.

    The method is Newton's on (-f)^(-1/2), which is almost linear in the distance. A bracket keeps
    it safe.
    """
    if not 0.0 < share < 1.0:
        return nan
    if share == 0.5:
        return 0.0
    smaller = share if share < 0.5 else 1.0 - share
    wanted = 1.0 / sqrt(-2.0 * even_part(lateral, half, other_half) * smaller)
    low, high = 0.0, inf
    x = 0.0
    for _ in range(MOST_ITERATIONS):
        f, slope = ahead_integral_and_slope(x, lateral, half, other_half)
        value = 1.0 / sqrt(-f)
        if value < wanted:
            low = x
        else:
            high = x
        step = (wanted - value) * 2.0 * -f / (value * slope)
        following = x + step
        if not low <= following <= high:
            following = 0.5 * (low + high) if high < inf else 2.0 * low + 1.0
        last = abs(following - x) <= LAST_STEP * following
        x = following
        if last:
            break
    return x if share > 0.5 else -x


@kernel
def _even(span_ratio: FloatArray, i: int, m: int) -> float:
    """Return E of birds i and i + 1."""
    lateral = span_ratio[i, m] + span_ratio[i + 1, m] + TIP_SPACING
    return even_part(
        lateral, VORTEX_FRACTION * span_ratio[i, m], VORTEX_FRACTION * span_ratio[i + 1, m]
    )
