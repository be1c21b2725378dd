# SPDX-License-Identifier: Apache-2.0
"""The interaction integral against a quadrature of the velocity, to 50 digits."""

from math import inf, nextafter

import mpmath
import numpy as np
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st
from mpmath import mp

from flock_sim.physics.aerodynamics import (
    ahead_integral,
    ahead_integral_gradient,
    even_part,
    interaction_integral,
)
from support.steady_flocks import A, integral

EPS = 2.0**-52

# x of 1e-12 costs 24 digits in v-hat's bound part, x of 1e6 and nearly touching vortices some 10
# each: 85 leave 50.
DIGITS = 85

DISTANCES = [1e-12, 1e-9, 1e-6, 1e-3, 0.1, 0.7, 1.0, 1.7853, 1.7854, 3.0, 10.0, 1e3, 1e6]

# (y, a, a'): |y| > a + a'
GEOMETRIES = {
    "standard neighbours": (1.0 + A, A, A),
    "large behind small": (1.0 + A, 0.9 * A, 1.1 * A),
    "small behind large": (1.0 + A, 1.1 * A, 0.9 * A),
    "very unequal": (2.1 + A - 1.0, 2.0 * A, 0.1 * A),
    "second neighbours": (2.0 * (1.0 + A), A, A),
    "far to the side": (100.0, A, 0.5 * A),
    "on the other side": (-(1.0 + A), A, 0.8 * A),
    "nearly touching": (2.0 * A + 1e-3, A, A),
    "touching but for 1e-6": (1.1 * A + 1e-6, A, 0.1 * A),
}


def induced_velocity(x, y, a):
    """v-hat of the horseshoe, Eqs. (vz0) and (vzpm): its bound part and its two trailing parts."""
    plus, minus = mp.hypot(x, y + a), mp.hypot(x, y - a)
    bound = ((y + a) / plus - (y - a) / minus) / x if x else mp.zero
    return bound, (1 + x / plus) / (a + y), (1 + x / minus) / (a - y)


def quadrature(integrand, half, gap):
    """Integrate from -half to half; the integrand is nearly singular `gap` outside of both ends."""
    panels, width = [mp.zero], mp.mpf(gap)
    steps = []
    while width < half:
        steps.append(half - width)
        width *= 4
    panels = [-half, *(-s for s in steps), 0, *reversed(steps), half]
    return mp.quad(integrand, panels, method="gauss-legendre")


def by_quadrature(x, y, a, b):
    """I as the paper defines it: v-hat over the wing of the second bird."""
    x, y, a, b = (mp.mpf(value) for value in (x, y, a, b))
    gap = abs(y) - a - b
    return quadrature(lambda s: sum(induced_velocity(x, y + s, a)), b, gap)


def by_closed_form(x, y, a, b):
    """I by Eqs. (I), (I0), (Ipm) with the closed form's signs."""
    return integral(*(mp.mpf(value) for value in (x, y, a, b)), of=mp)


def trailing_closed_form(x, y, a, b, sign):
    """I_+ or I_-, right-hand side of Eq. (Ipm), K(x, y) being -asinh(x / |y|)."""
    upper, lower = y + b + sign * a, y - b + sign * a
    wake = mp.asinh(x / abs(lower)) - mp.asinh(x / abs(upper))
    return sign * (mp.log(abs(upper / lower)) + wake)


def assert_as_good_as_promised(value, exact):
    """Relative 1e-13 where I is not near a zero, absolute 1e-15 elsewhere: as issued, not tuned."""
    assert abs(mp.mpf(float(value)) - exact) <= max(mp.mpf("1e-13") * abs(exact), mp.mpf("1e-15"))


@pytest.mark.parametrize("sign", [1.0, -1.0], ids=["in the wake", "ahead"])
@pytest.mark.parametrize("geometry", GEOMETRIES.values(), ids=GEOMETRIES)
def test_integral_is_that_of_the_induced_velocity(geometry, sign):
    with mpmath.workdps(DIGITS):
        for distance in [0.0, *DISTANCES]:
            exact = by_quadrature(sign * distance, *geometry)
            # What the sweep below measures against is the same number, to 50 digits.
            closed = by_closed_form(sign * distance, *geometry)
            assert abs(closed - exact) <= mp.mpf("1e-50") * abs(exact)
            assert_as_good_as_promised(interaction_integral(sign * distance, *geometry), exact)


ratios = st.floats(0.02, 2.0)


@st.composite
def wings(draw):
    """(y, a, a') of two birds of a flock: adjacent, or further apart."""
    one, other = draw(ratios), draw(ratios)
    assume(one + other > 1.001)
    apart = draw(st.sampled_from([1.0, 1.0, 2.0, 7.5, 100.0]))
    return apart * (one + other + A - 1.0), A * one, A * other


distances = st.one_of(st.floats(0.0, 10.0), st.floats(-12.0, 6.0).map(lambda power: 10.0**power))


@given(x=distances, geometry=wings())
@example(x=5e-324, geometry=(1.0 + A, A, A))
def test_integral_is_accurate_wherever_birds_can_be(x, geometry):
    with mpmath.workdps(DIGITS):
        for side in (x, -x):
            exact = by_closed_form(side, *geometry)
            assert_as_good_as_promised(interaction_integral(side, *geometry), exact)


@pytest.mark.parametrize("distance", [0.0, *DISTANCES])
@pytest.mark.parametrize("geometry", GEOMETRIES.values(), ids=GEOMETRIES)
def test_gradient_is_that_of_the_integral_ahead(distance, geometry):
    wing = (abs(geometry[0]), *geometry[1:])
    found = ahead_integral_gradient(distance, *wing)
    with mpmath.workdps(DIGITS):
        exact = [
            mp.diff(lambda *wing: by_closed_form(-distance, *wing), wing, order)
            for order in ((1, 0, 0), (0, 1, 0), (0, 0, 1))
        ]
        # Each edge adds (1 + u / (X + J)) / (J + u), which is rounded a few times.
        y, a, b = wing
        edges = [y + a + b, y - a - b, y + a - b, y - a + b]
        size = sum(2.0 / (np.hypot(distance, u) + u) for u in edges)
        for value, expected in zip(found, exact):
            assert abs(mp.mpf(value) - expected) <= 8.0 * EPS * size


@pytest.mark.parametrize("sign", [1, -1], ids=["I_+", "I_-"])
@pytest.mark.parametrize("x", [-3.0, -0.4, 0.0, 0.4, 3.0])
def test_trailing_parts_integrate_to_the_closed_form_not_to_the_printed_step(x, sign):
    # Eq. (Ipm) prints I_pm = pm int v_pm = pm [...]: for I_- the two cannot both be. The closed
    # form is right, and it is the plain integral, without the sign.
    y, a, b = 1.9, 0.8, 0.6
    with mpmath.workdps(DIGITS):
        arguments = tuple(mp.mpf(value) for value in (x, y, a, b))
        by_parts = quadrature(
            lambda s: induced_velocity(arguments[0], arguments[1] + s, arguments[2])[
                1 if sign > 0 else 2
            ],
            arguments[3],
            y - a - b,
        )
        closed = trailing_closed_form(*arguments, sign)
        assert abs(by_parts - closed) < mp.mpf("1e-50")
        if sign < 0:
            assert abs(-by_parts - closed) > 0.1


@given(x=st.floats(-1e3, 1e3).filter(bool), geometry=wings())
def test_a_pair_shares_a_sum_that_does_not_depend_on_its_streamwise_distance(x, geometry):
    y, a, b = geometry
    both = float(interaction_integral(x, y, a, b)) + float(interaction_integral(-x, y, a, b))
    even = even_part(y, a, b)
    # 2 E - f is rounded once, adding f back once more: half an ulp each, of at most 2 |E| + |f|.
    largest = 2.0 * abs(even) + abs(ahead_integral(abs(x), y, a, b))
    assert abs(both - 2.0 * even) <= EPS * largest


@given(geometry=wings())
def test_side_by_side_both_feel_the_even_part(geometry):
    y, a, b = geometry
    with mpmath.workdps(DIGITS):
        exact = mp.log(1 - 4 * mp.mpf(a) * b / (mp.mpf(y) ** 2 - (mp.mpf(a) - b) ** 2))
        assert_as_good_as_promised(even_part(y, a, b), exact)
        assert_as_good_as_promised(ahead_integral(0.0, y, a, b), exact)


@given(x=distances, geometry=wings())
def test_swapping_the_two_wings_changes_no_bit(x, geometry):
    y, a, b = geometry
    assert ahead_integral(x, y, a, b) == ahead_integral(x, y, b, a)
    assert even_part(y, a, b) == even_part(y, b, a)


@given(x=distances, geometry=wings())
def test_left_and_right_are_the_same(x, geometry):
    y, a, b = geometry
    for side in (x, -x):
        assert interaction_integral(side, y, a, b) == interaction_integral(side, -y, a, b)


@pytest.mark.parametrize("geometry", GEOMETRIES.values(), ids=GEOMETRIES)
def test_upwash_far_ahead_fades_as_the_inverse_square(geometry):
    # I ~ -2 a a' / x^2 (1 + c (y/x)^2 ...) with c of order 1; by quadrature and by the kernel.
    y, a, b = geometry
    with mpmath.workdps(DIGITS):
        for x in (1e3 * abs(y), 1e6 * abs(y)):
            leading = -2 * mp.mpf(a) * b / mp.mpf(x) ** 2
            correction = 3 * mp.mpf(y) ** 2 / mp.mpf(x) ** 2
            assert abs(by_quadrature(-x, *geometry) / leading - 1) < correction
            # Issued accuracy is absolute so far out; the kernel does better, to a few roundings:
            # two terms of size 1/x^2 that share no leading digits cancel by half.
            value = mp.mpf(float(interaction_integral(-x, *geometry)))
            assert abs(value / leading - 1) < correction + 64 * EPS


def test_drag_saved_grows_monotonically_into_the_wake():
    # dI/dx has no zero for the standard neighbours: the steady gap follows from one scalar root.
    found = interaction_integral(np.linspace(-50.0, 50.0, 20001), 1.0 + A, A, A)
    assert np.all(np.diff(found) < 0.0)
    assert np.all(found < 0.0)


def test_arguments_broadcast():
    x = np.linspace(-3.0, 3.0, 5)[:, np.newaxis]
    half = np.array([0.5, 0.6, 0.7])
    table = interaction_integral(x, 2.0, half, 0.7)
    assert table.shape == (5, 3)
    assert table[1, 2] == interaction_integral(x[1, 0], 2.0, 0.7, 0.7)


@pytest.mark.parametrize("y", [0.0, 1.0, -1.0, 2.0 * A, -2.0 * A])
def test_wings_whose_vortices_overlap_sideways_are_refused(y):
    with pytest.raises(ValueError, match=r"\|y\| must be above a \+ a'"):
        interaction_integral(1.0, y, A, A)


def test_one_overlap_among_many_is_refused():
    with pytest.raises(ValueError, match="must be above"):
        interaction_integral(1.0, np.array([2.0, 1.5, 2.0]), A, A)


def test_the_narrowest_gap_is_finite():
    narrowest = nextafter(2.0 * A, inf)
    assert np.isfinite(interaction_integral(np.array([-1.0, 0.0, 1.0]), narrowest, A, A)).all()
