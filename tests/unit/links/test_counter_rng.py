# SPDX-License-Identifier: Apache-2.0
"""Random numbers of links: the published values, uniform, and a function of their key alone."""

from __future__ import annotations

import math
import re

import mpmath
import numpy as np
import pytest

from flock_sim.links.counter_rng import FATE, NOISE, gaussians, philox, uniforms
from flock_sim.physics.compile import anew

DRAWS = 20000

SIGMAS = 5.0
"""Standard errors that a mean may be off by: by chance in one of two million tests."""


# Known answers of the authors (Random123, tests/kat_vectors): philox4x32, 10 rounds.
@pytest.mark.parametrize(
    ("key", "counter", "words"),
    [
        (0, (0, 0, 0, 0), (0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8)),
        (2**64 - 1, (2**32 - 1,) * 4, (0x408F276D, 0x41C83B0E, 0xA20BC7C6, 0x6D5451FD)),
        (
            0x299F31D0_A4093822,
            (0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344),
            (0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1),
        ),
    ],
)
def test_the_generator_gives_the_words_that_its_authors_publish(key, counter, words):
    assert tuple(map(int, philox(np.uint64(key), *map(np.uint64, counter)))) == words


def draws(kind: int, of=uniforms) -> np.ndarray:
    return np.array([of(1, 3, 4, step, kind) for step in range(DRAWS)])


def test_uniforms_are_even_and_a_pair_of_them_independent():
    u = draws(FATE)
    assert u.min() >= 0.0
    assert u.max() < 1.0
    # Mean 1/2 with variance 1/12; the product of the deviations has mean 0, variance 1/144.
    assert np.all(abs(u.mean(axis=0) - 0.5) < SIGMAS * math.sqrt(1.0 / 12.0 / DRAWS))
    product = ((u[:, 0] - 0.5) * (u[:, 1] - 0.5)).mean()
    assert abs(product) < SIGMAS * math.sqrt(1.0 / 144.0 / DRAWS)
    # Of successive steps, too.
    succession = ((u[1:, 0] - 0.5) * (u[:-1, 0] - 0.5)).mean()
    assert abs(succession) < SIGMAS * math.sqrt(1.0 / 144.0 / DRAWS)


def test_gaussians_have_the_moments_of_the_normal_distribution():
    g = draws(NOISE, gaussians)
    # Moments 0, 1, 0, 3 of orders 1 to 4; the k-th power has variance E g^2k - (E g^k)^2.
    for order, moment, square in ((1, 0.0, 1.0), (2, 1.0, 3.0), (3, 0.0, 15.0), (4, 3.0, 105.0)):
        error = math.sqrt((square - moment**2) / DRAWS)
        assert np.all(abs((g**order).mean(axis=0) - moment) < SIGMAS * error)
    assert abs((g[:, 0] * g[:, 1]).mean()) < SIGMAS / math.sqrt(DRAWS)


def test_gaussians_are_those_of_box_and_muller_to_four_units_of_the_last_place():
    # In units of 2^-52: 2 for the logarithm, of which its root has half, 1.9 for the sine, and 1/2
    # each for the rounding of root and product.
    with mpmath.workdps(40):
        for step in range(500):
            u, v = map(mpmath.mpf, uniforms(1, 3, 4, step, NOISE))
            radius, angle = mpmath.sqrt(-2 * mpmath.log(1 - u)), 2 * mpmath.pi * v
            exact = radius * mpmath.cos(angle), radius * mpmath.sin(angle)
            for value, wanted in zip(gaussians(1, 3, 4, step, NOISE), exact, strict=True):
                assert abs(mpmath.mpf(value) - wanted) < 4 * 2.0**-52 * abs(wanted)


def test_gaussians_call_no_elementary_function_of_the_c_library():
    fresh = anew(gaussians)
    fresh(1, 3, 4, 0, NOISE)
    (code,) = fresh.inspect_llvm().values()
    called = set(re.findall(r"call [^@\n]*@([\w.]+)\(", code))
    # LLVM makes an instruction of sqrt, whose last bit IEEE 754 defines.
    assert "sqrt" in called
    elementary = {"log", "log1p", "sin", "cos", "exp", "pow", "fma"}
    assert not {part for name in called for part in name.split(".")} & elementary


def test_numbers_for_another_seed_link_step_or_purpose_are_others():
    key = (1, 3, 4, 100, NOISE)
    others = {
        uniforms(*key[:at], value, *key[at + 1 :])
        for at in range(5)
        for value in (2, 5, 2**15)
        if at != 3
    } | {uniforms(1, 3, 4, 100 + 2**32, NOISE), uniforms(1, 4, 3, 100, NOISE), uniforms(*key)}
    assert len(others) == 12 + 3
