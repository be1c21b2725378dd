# SPDX-License-Identifier: Apache-2.0
"""Compiled loops compute by IEEE 754, so that all callers get the same bits."""

import math

import pytest

from flock_sim.physics.compile import anew, kernel


@kernel
def divide(numerator: float, denominator: float) -> float:
    return numerator / denominator


@kernel
def add_and_take_away(small: float, large: float) -> float:
    return (small + large) - large


@kernel
def multiply_and_add(factor: float, other: float, term: float) -> float:
    return factor * other + term


def test_division_by_zero_gives_infinity_and_stops_nobody():
    assert divide(1.0, 0.0) == math.inf
    assert divide(-1.0, 0.0) == -math.inf
    assert math.isnan(divide(0.0, 0.0))


def test_terms_are_not_reassociated():
    # With fastmath the compiler may see that small + large - large is small.
    assert add_and_take_away(1.0, 1e17) == 0.0


def test_multiply_and_add_round_twice():
    # 1 - 2^-54 rounds to 1 before the addition; a fused operation would keep -2^-54.
    factor, other = 1.0 + 2.0**-27, 1.0 - 2.0**-27
    assert multiply_and_add(factor, other, -1.0) == 0.0


@pytest.mark.parametrize("value", [math.nan, math.inf, 5e-324, -0.0])
def test_no_value_is_assumed_away(value):
    through = divide(value, 1.0)
    assert math.isnan(through) if math.isnan(value) else through == value
    assert math.copysign(1.0, through) == math.copysign(1.0, value) or math.isnan(value)


def test_a_copy_has_a_symbol_that_no_kernel_on_disk_has():
    copy = anew(divide)
    assert divide(1.0, 2.0) == copy(1.0, 2.0)
    (kept,), (made,) = divide.overloads.values(), copy.overloads.values()
    assert kept.fndesc.qualname != made.fndesc.qualname
