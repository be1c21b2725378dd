# SPDX-License-Identifier: Apache-2.0
"""The interaction of two birds, compiled: single evaluations, and the integral I of arrays."""

import numpy as np

from flock_sim.physics import interaction
from flock_sim.physics.arrays import FloatArray
from flock_sim.physics.compile import elementwise, inlined

even_part = inlined(interaction.even_part)
ahead_integral_and_slope = inlined(interaction.ahead_integral_and_slope)
ahead_integral_gradient = inlined(interaction.ahead_integral_gradient)
split_drag = inlined(interaction.split_drag)


@inlined
def ahead_integral(
    distance: float, lateral: float, source_half: float, target_half: float
) -> float:
    """Return f, the interaction integral of a target that is `distance` >= 0 ahead of its source.

    All arguments are in b, `lateral` > `source_half` + `target_half`. The result is dimensionless,
    E at distance 0, and goes to zero as -2 a a' / distance^2. Eqs. (I), (I0), (Ipm) for x <= 0;
    symmetric in the two half-spans to the last bit.
    """
    return ahead_integral_and_slope(distance, lateral, source_half, target_half)[0]


@elementwise
def _integral(x: float, lateral: float, source_half: float, target_half: float) -> float:
    ahead = ahead_integral(abs(x), abs(lateral), source_half, target_half)
    return split_drag(x, 1.0, ahead, even_part(abs(lateral), source_half, target_half))[0]


def interaction_integral(
    x: FloatArray | float,
    lateral: FloatArray | float,
    source_half: FloatArray | float,
    target_half: FloatArray | float,
) -> FloatArray:
    """Return the interaction integral I(x, y, a, a'), elementwise. Eq. (I).

    `x` is source minus target, so a target behind its source has x > 0 and is in the full wake;
    `lateral` is y, of either sign; `source_half` and `target_half` are a and a'. All are in b and
    broadcast together; the result is dimensionless, negative where drag is saved.

    Raises ValueError where |y| <= a + a': the bound vortices would overlap sideways, where the
    integral is singular.
    """
    if np.any(np.abs(lateral) <= np.add(source_half, target_half)):
        raise ValueError("|y| must be above a + a', so that the bound vortices do not overlap")
    return np.asarray(_integral(x, lateral, source_half, target_half), dtype=np.float64)
