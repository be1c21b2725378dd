# SPDX-License-Identifier: Apache-2.0
"""How numbers are held and how their loops are compiled."""

import hashlib
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from types import FunctionType
from typing import Any, TypeAlias, TypeVar

import numba
import numpy as np
import numpy.typing as npt

FloatArray: TypeAlias = npt.NDArray[np.float64]
IntArray: TypeAlias = npt.NDArray[np.int64]

HERE = Path(__file__).resolve().parent
CACHE = HERE / "__pycache__" / "kernels"

Function = TypeVar("Function", bound=Callable[..., object])

RULES = {"error_model": "numpy", "fastmath": False, "nogil": True}
"""How all kernels are compiled."""


def kernel(function: Function) -> Function:
    """Compile a loop over numbers; compiled code is kept on disk beside the module.

    Arithmetic is that of IEEE 754 to the letter: no `fastmath`, so that every caller gets the same
    bits, and 1/0 = inf, so that a member that diverges stops nobody. Loops leave the interpreter
    to others: threads can share out the members of an ensemble.
    """
    with _cache_of_this_version():
        compiled: Function = numba.njit(cache=True, **RULES)(function)
    return compiled


def anew(function: Function, **callees: Callable[..., object]) -> Function:
    """Compile a function, or a kernel once more, by the same rules, for this process only.

    `callees` stand in for what it calls by these names: what is kept on disk does not know them.
    """
    plain: Any = getattr(function, "py_func", function)
    names = {**plain.__globals__, **callees}
    copy = FunctionType(
        plain.__code__, names, plain.__name__, plain.__defaults__, plain.__closure__
    )
    compiled: Function = numba.njit(**RULES)(copy)
    return compiled


def elementwise(function: Callable[..., float]) -> Callable[..., FloatArray]:
    """Compile a function of numbers into one of arrays, under the same rules."""
    with _cache_of_this_version():
        compiled: Callable[..., FloatArray] = numba.vectorize(cache=True)(function)
    return compiled


@contextmanager
def _cache_of_this_version() -> Iterator[None]:
    """Have numba look for compiled code that was made from exactly these sources.

    By itself it looks at the age of the file that a kernel is in, and would go on with what an
    older version of another file was compiled into.
    """
    before = numba.config.CACHE_DIR
    directory = CACHE / sources_digest()
    if os.access(directory if directory.exists() else HERE, os.W_OK):
        numba.config.CACHE_DIR = str(directory)
    try:
        yield
    finally:
        numba.config.CACHE_DIR = before


@cache
def sources_digest() -> str:
    """Return what names this version of the core: a digest of all its files."""
    digest = hashlib.sha256()
    for path in sorted(HERE.rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]
