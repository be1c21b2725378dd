# SPDX-License-Identifier: Apache-2.0
"""The speed that a flock in steady flight has, whatever its formation.

Every pair's D_ij + D_ji = Gamma_i Gamma_j E_ij / (2 pi) is the same at any streamwise distance, so
the sum of all force balances knows nothing of positions. With u = U*^2, divided by k,

    A_2 u^2 - 2 H_0 A_4 u + A_4 + S = 0,    A_p = sum_j lambda_j^p,
    S = sum over pairs of s lambda_i^2 lambda_j^2 E_ij,
    s = Gamma_min^2 / (2 pi k) = 4 e_O / pi^2.
"""

from math import sqrt

from flock_sim.core.kernel import elementwise, kernel


@kernel
def steady_square(squares: float, fourths: float, saving: float, cruise_ratio: float) -> float:
    """Return u = U*^2 > 0 on the higher-speed branch, in U_min^2; nan where no speed balances.

    `squares` = A_2, `fourths` = A_4, `saving` = S <= 0, `cruise_ratio` = H_0. On the lower branch
    drag falls with speed, and flight is unstable.
    """
    half = cruise_ratio * fourths
    return (half + sqrt(half * half - squares * (fourths + saving))) / squares


@kernel
def balance(span_ratio: float, square: float, cruise_ratio: float) -> float:
    """Return (T_j - D_j) / k at U^2 = `square`: the interaction drag that keeps bird j's speed.

    Below 0 for a bird that has to save drag. Eqs. (eom3), (scaling).
    """
    ratio = span_ratio * span_ratio
    return ratio * (ratio * (2.0 * cruise_ratio - 1.0 / square) - square)


@elementwise
def balances(span_ratio: float, square: float, cruise_ratio: float) -> float:
    """Return `balance`, elementwise."""
    return balance(span_ratio, square, cruise_ratio)
