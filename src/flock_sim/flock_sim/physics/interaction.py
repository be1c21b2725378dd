# SPDX-License-Identifier: Apache-2.0
"""The aerodynamic interaction of two birds: the integral I, which gives the drag D_ij.

Each wing is a horseshoe vortex: a bound segment of half-length a and two trailing vortices. The
paper integrates the velocity that one horseshoe induces over the bound segment of the other,
I = I_0 + I_+ + I_- (Eqs. I, I0, Ipm). With y > a + a' (bound segments that do not overlap
sideways) the four edges lie at the lateral distances

    p = y + a + a'    q = y + |a - a'|    r = y - |a - a'|    s = y - a - a'

and with J(u) = sqrt(x^2 + u^2) the closed form becomes, written without 0/0 and without
cancellation,

    I(x) = f(|x|)          for x <= 0, a target ahead of (or beside) its source,
    I(x) = 2 E - f(|x|)    for x >= 0, a target in the wake of its source,

    f(X) = ln[(X + J(p)) (X + J(s)) / ((X + J(q)) (X + J(r)))] - (J(p) + J(s) - J(q) - J(r)) / X
    E    = f(0) = ln[p s / (q r)] = ln[1 - 4 a a' / (y^2 - (a - a')^2)]

E is the part of I that is even in x, so D_ij + D_ji does not depend on the streamwise distance.
One evaluation of f (four square roots, one logarithm) gives both D_ij and D_ji, and `split_drag`
decides which is which. It also gives the derivative f'(X) = (J(p) + J(s) - J(q) - J(r)) / X^2,
since all its terms are known.

These are plain functions of numbers, for a few evaluations without numba. `physics.aerodynamics`
compiles kernels from them: the operations are the same, and so are the bits.
"""

from math import log, log1p, pi, sqrt

PER_FOUR_PI = 1.0 / (4.0 * pi)

# Below this argument log1p loses digits by cancellation as the inner vortices come close; the plain
# logarithm of the product of edges does not.
NEAR_TOUCH = -0.5


def even_part(lateral: float, source_half: float, target_half: float) -> float:
    """Return E, the part of the interaction integral that is even in x.

    Parameters are in b: `lateral` = |y| > `source_half` + `target_half`, the vortex half-spans a
    and a'. The result is dimensionless and negative. Eq. (pairingC_x) is Gamma^2 E / (2 pi) for
    a = a'.
    """
    large = max(source_half, target_half)
    small = min(source_half, target_half)
    outer = lateral + large
    inner = lateral - large
    excess = -4.0 * large * small / ((outer - small) * (inner + small))
    if excess < NEAR_TOUCH:
        return log((outer + small) * (inner - small) / ((outer - small) * (inner + small)))
    return log1p(excess)


def ahead_integral_and_slope(
    distance: float, lateral: float, source_half: float, target_half: float
) -> tuple[float, float]:
    """Return f of `ahead_integral` and its derivative f' > 0 by the distance X, in 1 / b.

    J(p) + J(s) - J(q) - J(r) = X^2 f' is computed in two ways. Close by, it is computed from
    J(u) - u = X^2 / (J(u) + u), where the leading terms cancel by p + s = q + r. Far away, it is
    computed from differences of squares, since the J themselves become equal. The argument of the
    logarithm minus one follows from it by
    J(p) J(s) - J(q) J(r) = 8 a a' (X^2 - y^2 + a^2 + a'^2) / (J(p) J(s) + J(q) J(r)).
    """
    large = max(source_half, target_half)
    small = min(source_half, target_half)
    outer = lateral + large
    inner = lateral - large
    p = outer + small
    q = outer - small
    r = inner + small
    s = inner - small
    square = distance * distance
    j_p = sqrt(square + p * p)
    j_q = sqrt(square + q * q)
    j_r = sqrt(square + r * r)
    j_s = sqrt(square + s * s)

    if distance < lateral:
        plus_p = j_p + p
        plus_q = j_q + q
        plus_r = j_r + r
        plus_s = j_s + s
        p_s = plus_p * plus_s
        q_r = plus_q * plus_r
        slope = ((plus_p + plus_s) * q_r - (plus_q + plus_r) * p_s) / (p_s * q_r)
        bound = distance * slope
    else:
        j_pq = j_p + j_q
        j_sr = j_s + j_r
        bound = 4.0 * small * (outer * j_sr - inner * j_pq) / (j_pq * j_sr * distance)
        slope = bound / distance

    product = j_p * j_s + j_q * j_r
    beyond = square - (lateral * lateral - large * large - small * small)
    denominator = (distance + j_q) * (distance + j_r)
    excess = (square * bound + 8.0 * large * small * beyond / product) / denominator
    if excess < NEAR_TOUCH:
        return log((distance + j_p) * (distance + j_s) / denominator) - bound, slope
    return log1p(excess) - bound, slope


def split_drag(x: float, strength: float, ahead: float, even: float) -> tuple[float, float]:
    """Return the drags of a pair (on a bird, on the other), in the unit of `strength`. Eq. (Djk2).

    `x` is the other's position minus the bird's, `strength` is Gamma_i Gamma_j / (4 pi), `ahead` is
    f(|x|) and `even` is E of the pair. With strength 1, the results are the integrals I.
    """
    behind = 2.0 * even - ahead
    if x > 0.0:
        return strength * behind, strength * ahead
    if x < 0.0:
        return strength * ahead, strength * behind
    return strength * ahead, strength * ahead  # side by side: both get E, in either order
