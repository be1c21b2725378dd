# SPDX-License-Identifier: Apache-2.0
"""The speed of a flock in steady flight, which does not depend on its formation.

Every pair's D_ij + D_ji = Gamma_i Gamma_j E_ij / (2 pi) is the same at any streamwise distance, so
the sum of all force balances does not depend on positions. With u = U*^2, divided by k,

    A_2 u^2 - 2 H_0 B u + A_4 + S = 0,    A_p = sum_j lambda_j^p,    B = sum_j t_j lambda_j^4,
    S = sum over pairs of s lambda_i^2 lambda_j^2 E_ij,
    s = Gamma_min^2 / (2 pi k) = 4 e_O / pi^2,

where t_j is the thrust of bird j over that of the model, lambda_j^4 T_0.
"""

from math import sqrt

import numpy as np

from flock_sim.physics.arrays import FloatArray
from flock_sim.physics.compile import kernel


@kernel
def steady_square(
    squares: float, fourths: float, saving: float, cruise_ratio: float, added: float = 0.0
) -> float:
    """Return u = U*^2 > 0 on the higher-speed branch, in U_min^2; nan if no speed balances.

    `squares` = A_2, `fourths` = A_4, `saving` = S <= 0, `cruise_ratio` = H_0, `added` = B - A_4. On
    the lower branch drag falls with speed, and flight is unstable.
    """
    half = cruise_ratio * (fourths + added)
    return (half + sqrt(half * half - squares * (fourths + saving))) / squares


@kernel
def balance(span_ratio: float, square: float, cruise_ratio: float) -> float:
    """Return (T_j - D_j) / k at U^2 = `square`: the interaction drag that keeps bird j's speed.

    It is below 0 for a bird that has to save drag. `cruise_ratio` is H_0 t_j.
    Eqs. (eom3), (scaling).
    """
    ratio = span_ratio * span_ratio
    return ratio * (ratio * (2.0 * cruise_ratio - 1.0 / square) - square)


def balances(
    span_ratio: FloatArray, square: FloatArray | float, cruise_ratio: FloatArray | float
) -> FloatArray:
    """Return `balance`, elementwise: the same operations in the same order, so the same bits."""
    with np.errstate(all="ignore"):
        ratio = span_ratio * span_ratio
        balanced: FloatArray = ratio * (ratio * (2.0 * cruise_ratio - 1.0 / square) - square)
    return balanced
