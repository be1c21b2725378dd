# SPDX-License-Identifier: Apache-2.0
"""The loops of a stage are vectorised, call no library, and give the same bits at any length."""

from __future__ import annotations

import math
import platform
import re

import numpy as np
import pytest

from flock_sim.launcher.precompile import warm_bird, warm_reference
from flock_sim.physics.compile import anew
from flock_sim.physics.dynamics import drag_of_pair
from flock_sim.physics.stage_kernels import (
    CIRCULATION,
    DISTANCE,
    EVEN,
    HALF_SPAN,
    LANES,
    LATERAL,
    ON_BIRD,
    ON_OTHER,
    OTHER_CIRCULATION,
    OTHER_HALF_SPAN,
    ROWS,
    compute_drags,
    elements,
    fill_interactions,
    interaction_array,
    move,
)
from flock_sim.protocol.bird_kernel import feel_and_move
from flock_sim.reference.flock_kernel import advance

PACKED = {
    "x86_64": {"division": r"\bv?divpd\b", "root": r"\bv?sqrtpd\b"},
    "aarch64": {"division": r"\bfdiv\s+v\d+\.2d", "root": r"\bfsqrt\s+v\d+\.2d"},
}
"""Instructions with several numbers of 64 bits, by machine."""

TRANSCENDENTAL = re.compile(
    r"@(?:llvm\.)?((?!_Z)\w*(?:log|exp|pow|sin|cos|tan|hypot|cbrt|gamma|erf)\w*)(?:\.f64)?\("
)
"""A function of the mathematical library in LLVM's code, whose names otherwise are mangled."""


def recompiled(function, *arguments):
    """Return a kernel that this process compiled for these arguments: code on disk has no text."""
    copy = anew(function)
    copy(*arguments)
    return copy


def log_of_c(x: float) -> float:
    return math.log(x) + math.log1p(x)


def drawn(pairs: int, members: int) -> np.ndarray:
    """Return an interaction array of random pairs, some of them side by side or diverged."""
    random = np.random.default_rng(pairs * 1000 + members)
    array, count = interaction_array(pairs, members), pairs * members
    half, other = random.uniform(0.3, 1.5, (2, count))
    fill_interactions(array, 0, half + other + random.uniform(1e-4, 20.0, count), half, other)
    array[DISTANCE, :count] = random.normal(scale=10.0, size=count)
    array[DISTANCE, 0:count:7] *= 1e5
    array[DISTANCE, 3:count:11] = 0.0
    array[DISTANCE, 5:count:13] = np.nan
    array[DISTANCE, 6:count:17] = np.inf
    array[CIRCULATION, :count], array[OTHER_CIRCULATION, :count] = random.uniform(0.05, 0.2, 2)[
        :, np.newaxis
    ]
    return array


def bits(values):
    return np.asarray(values, dtype=np.float64).view(np.int64).tolist()


@pytest.mark.parametrize(("pairs", "members"), [(1, 1), (2, 1), (12, 1), (1, 287), (12, 64)])
def test_drags_have_the_bits_of_single_pairs(pairs, members):
    array = drawn(pairs, members)
    compute_drags(array)
    rows = LATERAL, HALF_SPAN, OTHER_HALF_SPAN, EVEN, CIRCULATION, OTHER_CIRCULATION
    for element in range(pairs * members):
        alone = drag_of_pair(array[DISTANCE, element], *array[list(rows), element])
        assert bits(array[[ON_BIRD, ON_OTHER], element]) == bits(alone)


def test_an_interaction_array_is_full_and_its_rest_has_no_drag():
    for count in range(40):
        assert elements(count) % LANES == 0
        assert max(count, 1) <= elements(count) < max(count, 1) + LANES
    array = interaction_array(3, 1)
    assert array.shape == (ROWS, LANES)
    compute_drags(array)
    np.testing.assert_array_equal(array[[ON_BIRD, ON_OTHER]], 0.0)


def arguments_of_move(count: int):
    rows = np.ones((5, count))
    return 0, 1.0, rows, *(np.ones(count) for _ in range(7))


@pytest.mark.skipif(platform.machine() not in PACKED, reason="instructions of another processor")
def test_the_loops_have_packed_divisions_and_roots():
    patterns = PACKED[platform.machine()]
    (drags,) = recompiled(compute_drags, interaction_array(1, 1)).inspect_asm().values()
    assert re.search(patterns["division"], drags)
    assert re.search(patterns["root"], drags)
    (motion,) = recompiled(move, *arguments_of_move(1)).inspect_asm().values()
    assert re.search(patterns["division"], motion)


@pytest.mark.parametrize("function", [advance, feel_and_move], ids=["reference", "bird"])
def test_kernels_call_no_function_of_the_mathematical_library(function):
    warm_reference()
    warm_bird()
    copy = anew(function)
    copy.compile(function.signatures[0])
    (code,) = copy.inspect_llvm().values()
    assert "llvm.sqrt" in code  # the code of the functions that it calls is in it
    assert set(TRANSCENDENTAL.findall(code)) == set()


def test_the_search_for_library_functions_finds_them():
    copy = anew(log_of_c)
    copy(2.0)
    (code,) = copy.inspect_llvm().values()
    assert set(TRANSCENDENTAL.findall(code)) == {"log", "log1p"}
