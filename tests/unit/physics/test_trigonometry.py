# SPDX-License-Identifier: Apache-2.0
"""Sine and cosine: errors against a hundred digits, exact values, and no call of a library."""

from __future__ import annotations

import math
import re

import mpmath
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from flock_sim.physics.compile import anew
from flock_sim.physics.trigonometry import sine_and_cosine

ULP = 1.9
"""The largest error, in units of the last place, that the docstring promises."""

POINTS = 20000

DIGITS = 100

OCTANTS = [k / 8 for k in range(9)]

compiled = anew(sine_and_cosine)


@anew
def fill(turns: np.ndarray, sine: np.ndarray, cosine: np.ndarray) -> None:
    for k in range(turns.shape[0]):
        sine[k], cosine[k] = compiled(turns[k])


def angles() -> np.ndarray:
    """Angles in turns: even ones, small ones, and those at and around multiples of an octant."""
    random = np.random.default_rng(18)
    around = random.choice(OCTANTS, POINTS) + random.choice(
        [-1.0, 1.0], POINTS
    ) * 2.0 ** -random.uniform(3.0, 53.0, POINTS)
    next_to = [np.nextafter(OCTANTS, to) for to in (0.0, 1.0)]
    # The rounding of x counts most where x is just above a power of two and sin(x) below it.
    x = 0.25 * (1.0 + 0.02 * random.random(POINTS // 4))
    steep = 0.25 * np.arange(1, 4)[:, np.newaxis] + x / (2.0 * np.pi)
    drawn = random.random(POINTS), 2.0 ** -random.uniform(0.0, 1070.0, POINTS)
    found = np.concatenate([*drawn, around, *next_to, steep.ravel(), OCTANTS])
    return np.unique(found[(found >= 0.0) & (found <= 1.0)])


@pytest.mark.slow
def test_the_error_is_below_the_promised_one() -> None:
    turns = angles()
    assert len(turns) > 3 * POINTS
    found = np.empty((2, len(turns)))
    fill(turns, *found)
    with mpmath.workdps(DIGITS):
        for k, angle in enumerate(turns.tolist()):
            if 4.0 * angle == math.floor(4.0 * angle):
                continue
            radians = 2 * mpmath.pi * mpmath.mpf(angle)
            for value, exact in zip(found[:, k], (mpmath.sin(radians), mpmath.cos(radians))):
                error = abs(mpmath.mpf(float(value)) - exact) / math.ulp(float(exact))
                assert error < ULP, angle


@pytest.mark.parametrize(
    ("turns", "sine", "cosine"),
    [(0.0, 0, 1), (0.25, 1, 0), (0.5, 0, -1), (0.75, -1, 0), (1.0, 0, 1)],
)
def test_they_are_exact_at_quarter_turns(turns: float, sine: int, cosine: int) -> None:
    assert sine_and_cosine(turns) == (sine, cosine)
    assert compiled(turns) == (sine, cosine)


@given(st.floats(0.0, 1.0))
def test_compiled_they_have_the_same_bits(turns: float) -> None:
    plain, machine = sine_and_cosine(turns), compiled(turns)
    assert [value.hex() for value in plain] == [value.hex() for value in machine]


@given(st.floats(0.0, 0.5))
def test_half_a_turn_on_both_have_the_other_sign(turns: float) -> None:
    # The sum is exact for multiples of 2^-53 only, such as random numbers.
    angle = math.floor(turns * 2.0**53) * 2.0**-53
    sine, cosine = sine_and_cosine(angle)
    assert sine_and_cosine(angle + 0.5) == (-sine, -cosine)


def test_the_loop_is_vectorised_and_calls_no_library() -> None:
    fill(*np.zeros((3, 8)))
    (code,) = fill.inspect_llvm().values()  # type: ignore[attr-defined]
    assert re.search(r"fmul <\d+ x double>", code)
    assert not re.search(r"\bf(mul|add|sub) fast\b|@llvm\.(fma|fmuladd|sin|cos)|@(sin|cos)\b", code)
