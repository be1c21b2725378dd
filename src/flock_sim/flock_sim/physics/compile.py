# SPDX-License-Identifier: Apache-2.0
"""The compilation of loops over numbers."""

from collections.abc import Callable, Iterable, Iterator
from types import FunctionType
from typing import Any, TypeVar, cast
from uuid import uuid4

from flock_sim.physics.arrays import FloatArray
from flock_sim.physics.compiler import numba
from flock_sim.physics.kernel_cache import PACKAGE, KernelCache

Function = TypeVar("Function", bound=Callable[..., object])

RULES = {"error_model": "numpy", "fastmath": False, "nogil": True, "no_cfunc_wrapper": True}
"""Options of numba for all kernels. Nothing calls them by the conventions of C."""

INNER = {"no_cpython_wrapper": True}
"""Options of functions that only compiled code calls."""

_CALLABLE: set[FunctionType] = set()
"""The plain functions that kernels can call."""


def kernel(function: Function) -> Function:
    """Compile a loop over numbers; the compiled code of this package's kernels is kept on disk.

    Arithmetic follows IEEE 754 strictly: no `fastmath`, so that every caller gets the same bits,
    and 1/0 = inf, so that a diverging member does not stop the others. Loops release the global
    interpreter lock, so threads can share the members of an ensemble. Plain functions of this
    package that it calls are compiled into it.
    """
    return _compiled(function)


def inlined(function: Function) -> Function:
    """Compile a function of numbers, by the same rules, into each loop that calls it.

    A call would prevent the compiler from vectorising the loop.
    """
    return _compiled(function, forceinline=True)


def _compiled(function: Function, **options: bool) -> Function:
    _let_kernels_call(plain_callees(function))
    compiled: Function = numba.njit(**RULES, **options)(function)
    if _can_be_kept(function):
        compiled._cache = KernelCache(function)  # type: ignore[attr-defined]
    return compiled


def plain_callees(function: Any) -> Iterator[FunctionType]:
    """Yield the functions of this package, and of its own module, that a plain function calls."""
    for name in function.__code__.co_names:
        callee = function.__globals__.get(name)
        if isinstance(callee, FunctionType) and (
            _is_ours(callee) or callee.__module__ == function.__module__
        ):
            yield callee


def _let_kernels_call(functions: Iterable[FunctionType], **options: bool) -> None:
    """Compile plain functions, and those that they call; `options` are for those of the user."""
    for function in functions:
        if function not in _CALLABLE:
            _CALLABLE.add(function)
            _let_kernels_call(plain_callees(function), **options)
            own = INNER if _is_ours(function) else INNER | options
            numba.extending.register_jitable(**RULES, **own, forceinline=True)(function)


def anew(function: Function) -> Function:
    """Compile a function, or recompile a kernel, by the same rules, for this process only."""
    return _anew(function)


def anew_for_kernels(function: Function, **options: bool) -> Function:
    """Compile a function as `anew` does, with these options; only compiled code can call it."""
    return _anew(function, **INNER, **options)


def _anew(function: Function, **options: bool) -> Function:
    plain: Any = getattr(function, "py_func", function)
    names = plain.__globals__
    copy = FunctionType(
        plain.__code__, names, plain.__name__, plain.__defaults__, plain.__closure__
    )
    # numba numbers functions of equal names in each process, and code from disk has the number of
    # another process. Code with the name and the number of this copy would be run instead of it.
    # That code may contain copies, too, so the name of each copy is unique.
    copy.__qualname__ = f"anew.{plain.__qualname__}.{uuid4().hex}"
    _let_kernels_call(plain_callees(copy), **options)
    compiled: Function = numba.njit(**RULES, **options)(copy)
    return compiled


def elementwise(function: Callable[..., float]) -> Callable[..., FloatArray]:
    """Compile a function of numbers into a function of arrays, by the same rules."""
    compiled: Any = numba.vectorize(function)
    if _can_be_kept(function):
        compiled._dispatcher.cache = KernelCache(function)
    return cast(Callable[..., FloatArray], compiled)


def _can_be_kept(function: Callable[..., object]) -> bool:
    """Whether a function is of this package and has no closure: the sources define it fully."""
    plain: Any = function
    return plain.__closure__ is None and _is_ours(function)


def _is_ours(function: Callable[..., object]) -> bool:
    return function.__module__.startswith(f"{PACKAGE.name}.")
