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

These are plain functions of numbers without branches. Kernels that call them compile them in, so
that a loop over pairs or members is vectorised; `physics.aerodynamics` compiles each of them for
single evaluations. The operations are the same everywhere, and so are the bits.
"""

from math import pi, sqrt

from flock_sim.physics.logarithm import log_of_quotient

PER_FOUR_PI = 1.0 / (4.0 * pi)

FAR = 1e30
"""Distance in b beyond which f and f' are those at this distance: they are below 1e-59."""


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
    outer_product = (outer + small) * (inner - small)
    inner_product = (outer - small) * (inner + small)
    return log_of_quotient(outer_product, inner_product, -4.0 * large * small)


def ahead_integral_and_slope(
    distance: float, lateral: float, source_half: float, target_half: float
) -> tuple[float, float]:
    """Return f of `ahead_integral` and its derivative f' > 0 by the distance X, in 1 / b.

    Differences of nearly equal numbers are avoided as follows. From J(u) - u = X^2 / (J(u) + u) and
    J(u)^2 - J(v)^2 = u^2 - v^2, with u_ = J(u) + u, A = max(a, a') and B = min(a, a'):

        f' = 4 B [(y + A) (r_ + s_) p_ q_ - (y - A) (p_ + q_) r_ s_]
             / [p_ q_ r_ s_ (J(p) + J(q)) (J(r) + J(s))]

    The difference of numerator and denominator of the logarithm's argument is
    X^3 f' + J(p) J(s) - J(q) J(r), where
    J(p) J(s) - J(q) J(r) = 8 a a' (X^2 - y^2 + a^2 + a'^2) / (J(p) J(s) + J(q) J(r)).
    Both fractions share one division.
    """
    x = FAR if distance > FAR else distance  # NaN stays
    large = max(source_half, target_half)
    small = min(source_half, target_half)
    outer = lateral + large
    inner = lateral - large
    p = outer + small
    q = outer - small
    r = inner + small
    s = inner - small
    square = x * x
    j_p = sqrt(square + p * p)
    j_q = sqrt(square + q * q)
    j_r = sqrt(square + r * r)
    j_s = sqrt(square + s * s)

    plus_p = j_p + p
    plus_q = j_q + q
    plus_r = j_r + r
    plus_s = j_s + s
    pq = plus_p * plus_q
    rs = plus_r * plus_s
    slope_top = 4.0 * small * (outer * (plus_r + plus_s) * pq - inner * (plus_p + plus_q) * rs)
    slope_bottom = pq * rs * ((j_p + j_q) * (j_r + j_s))
    beyond_top = (
        8.0 * large * small * (square - (lateral * lateral - large * large - small * small))
    )
    beyond_bottom = j_p * j_s + j_q * j_r
    reciprocal = 1.0 / (slope_bottom * beyond_bottom)
    slope = slope_top * beyond_bottom * reciprocal
    difference = (x * square * slope_top * beyond_bottom + beyond_top * slope_bottom) * reciprocal

    n = (x + j_p) * (x + j_s)
    d = (x + j_q) * (x + j_r)
    return log_of_quotient(n, d, difference) - x * slope, slope


def ahead_integral_gradient(
    distance: float, lateral: float, source_half: float, target_half: float
) -> tuple[float, float, float]:
    """Return the derivatives of f of `ahead_integral` by y, a and a' at the distance X, in 1 / b.

    Each edge u of the four adds ln(X + J(u)) - J(u) / X to f, whose derivative by u, without the
    part -1 / X that the four edges cancel, is (X + J(u) + u) / [(X + J(u)) (J(u) + u)]. Side by
    side, at X = 0, the results are the derivatives of E.
    """
    x = FAR if distance > FAR else distance  # NaN stays
    of_p = _edge_slope(x, lateral + source_half + target_half)
    of_s = _edge_slope(x, lateral - source_half - target_half)
    of_right = _edge_slope(x, lateral + source_half - target_half)
    of_left = _edge_slope(x, lateral - source_half + target_half)
    outer, inner = of_p - of_s, of_right - of_left
    return (of_p + of_s) - (of_right + of_left), outer - inner, outer + inner


def _edge_slope(x: float, edge: float) -> float:
    """Return what an edge at the lateral distance `edge` adds to df/dy, without its part -1 / x."""
    root = sqrt(x * x + edge * edge)
    return (x + root + edge) / ((x + root) * (root + edge))


def split_drag(x: float, strength: float, ahead: float, even: float) -> tuple[float, float]:
    """Return the drags of a pair (on a bird, on the other), in the unit of `strength`. Eq. (Djk2).

    `x` is the other's position minus the bird's, `strength` is Gamma_i Gamma_j / (4 pi), `ahead` is
    f(|x|) and `even` is E of the pair. With strength 1, the results are the integrals I. Side by
    side, both birds get E, in either order.
    """
    behind = 2.0 * even - ahead
    on_bird = behind if x > 0.0 else ahead
    on_other = behind if x < 0.0 else ahead
    return strength * on_bird, strength * on_other
