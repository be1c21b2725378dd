# SPDX-License-Identifier: Apache-2.0
"""The golden flights have the committed digests on processors that lack features of this one.

Each test starts Python with features hidden, and first checks that they are.
`make other-machine` computes the digests for a processor of another kind.
"""

from __future__ import annotations

import json
import os
import platform
from dataclasses import dataclass
from pathlib import Path

import pytest
from numpy._core import _multiarray_umath as numpy_core

from support.golden_flights import committed_digests
from support.python_process import python

TESTS = Path(__file__).parents[2]

PROBE = """
import json, math, sys

sys.path.insert(0, sys.argv[1])

from numba.core.registry import cpu_target
from numpy._core._multiarray_umath import __cpu_features__

from support.golden_flights import FLIGHTS, golden_digest

print(json.dumps({
    "digests": {name: golden_digest(name) for name in FLIGHTS},
    "library": [f(k / 10000.0) for f in (math.log, math.log1p, math.cos) for k in range(1, 20001)],
    "numpy": [name for name, there in __cpu_features__.items() if there],
    "numba": cpu_target.target_context.codegen().magic_tuple()[1:],
}))
"""


@dataclass(frozen=True)
class Answer:
    """What a Python process with another environment computed, and with what."""

    digests: dict[str, str]
    library: list[float]
    """Values of functions of the C library: a few have other last bits without FMA."""
    numpy: list[str]
    """Features of the processor that NumPy uses."""
    numba: list[str]
    """Name and features of the processor that numba compiles for."""


def ask(**environment: str) -> Answer:
    """Return the answer of a Python process with these variables in its environment."""
    answer = python(PROBE, str(TESTS), environment={**os.environ, **environment})
    return Answer(**json.loads(answer))


@pytest.mark.skipif(platform.machine() != "x86_64", reason="the hidden features are those of x86")
@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="only glibc can hide features")
@pytest.mark.slow
@pytest.mark.skipif(
    not (numpy_core.__cpu_features__.get("FMA3") and numpy_core.__cpu_features__.get("AVX2")),
    reason="this processor has no FMA and AVX2 that could be hidden",
)
def test_without_fma_and_avx2_in_the_c_library_and_numpy() -> None:
    hidden = [name for name in numpy_core.__cpu_dispatch__ if numpy_core.__cpu_features__[name]]
    answer = ask(
        GLIBC_TUNABLES="glibc.cpu.hwcaps=-AVX2,-FMA,-FMA4",
        NPY_DISABLE_CPU_FEATURES=" ".join(hidden),
    )
    assert answer.library != ask().library
    assert not set(answer.numpy) & set(hidden)
    assert answer.digests == committed_digests()


@pytest.mark.slow
def test_with_kernels_for_a_generic_processor() -> None:
    # Compiled in the first run only: the code is kept under the name of that processor.
    answer = ask(NUMBA_CPU_NAME="generic", NUMBA_CPU_FEATURES="")
    assert answer.numba == ["generic", ""]
    assert answer.digests == committed_digests()
