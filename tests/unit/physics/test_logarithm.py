# SPDX-License-Identifier: Apache-2.0
"""The logarithm of IEEE operations against mpmath."""

from math import inf, ldexp, nan

import mpmath
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from mpmath import mp

from flock_sim.physics.compile import kernel
from flock_sim.physics.logarithm import log, log_of_quotient

MOST = 2.0
"""The promised error, in ulp of the result."""

compiled = kernel(log_of_quotient)

normal = st.floats(2.0**-1000, 2.0**1000)
near = st.floats(0.5, 2.0)


def error_in_ulp(found, exact):
    """Return the error of a double, in units of the last place of the exact result."""
    if exact == 0:
        return abs(mp.mpf(float(found)))
    return float(abs(mp.mpf(float(found)) - exact) / mp.mpf(np.spacing(abs(float(exact)))))


@given(x=normal | near)
@example(x=1.0)
@example(x=1.0 - 2.0**-53)
@example(x=1.0 + 2.0**-52)
@example(x=2.0**-53)  # the least argument of the noise's logarithm
@example(x=0.7071067811865476)
@example(x=1.4142135623730951)
def test_log_is_as_good_as_promised(x):
    with mpmath.workdps(50):
        assert error_in_ulp(log(x), mp.log(mp.mpf(x))) < MOST


@given(d=st.floats(1.0, 2.0), power=st.integers(-70, -2), sign=st.sampled_from([1.0, -1.0]))
def test_the_log_of_a_quotient_uses_the_difference_to_all_its_digits(d, power, sign):
    # The sum n is rounded, and its last digits, which the difference has, are lost in it.
    difference = sign * ldexp(1.2345678901234567, power)
    with mpmath.workdps(50):
        exact = mp.log1p(mp.mpf(difference) / mp.mpf(d))
        # n + d is rounded: by 2^-53 at most, which is one more half ulp.
        assert error_in_ulp(log_of_quotient(d + difference, d, difference), exact) < MOST + 0.5


@given(n=normal, d=normal)
def test_a_quotient_and_its_inverse_have_opposite_logs(n, d):
    found, inverse = log_of_quotient(n, d, n - d), log_of_quotient(d, n, d - n)
    assert found == pytest.approx(-inverse, rel=4 * 2.0**-52)


def test_it_is_accurate_over_the_whole_range_of_a_binade():
    # Every 2^-12 of [1/4, 4], which holds both ends of the polynomial's range and the borders of k.
    worst = 0.0
    with mpmath.workdps(40):
        for x in np.arange(2.0**-2, 2.0**2, 2.0**-12):
            worst = max(worst, error_in_ulp(log(float(x)), mp.log(mp.mpf(float(x)))))
    assert 0.4 < worst < MOST  # a measure that never comes near an ulp would measure nothing


@given(n=normal | near, d=normal | near)
def test_plain_and_compiled_functions_give_the_same_bits(n, d):
    plain, found = log_of_quotient(n, d, n - d), compiled(n, d, n - d)
    assert np.float64(plain).view(np.int64) == np.float64(found).view(np.int64)


@pytest.mark.parametrize("bad", [nan, inf])
def test_numbers_that_are_not_finite_give_nan(bad):
    assert np.isnan(compiled(bad, bad, bad - bad))
    assert np.isnan(compiled(nan, 1.0, nan))
