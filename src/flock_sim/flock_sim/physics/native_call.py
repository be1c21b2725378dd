# SPDX-License-Identifier: Apache-2.0
"""Addresses in compiled code: those of memory, and those of compiled functions.

A kernel that calls a function by its address is not compiled again for another function.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from flock_sim.physics.compiler import numba

ADDRESS: Any = numba.types.intp
"""The type of an address in compiled code."""


@numba.extending.intrinsic
def pointer(_: Any, address: Any) -> Any:
    """Convert a number to an address."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.inttoptr(arguments[0], numba.core.cgutils.voidptr_t)

    return numba.types.voidptr(address), generate


def address_of(compiled: Any, types: Sequence[Any]) -> int:
    """Compile a function for these types of its arguments, and return the address of its code.

    The address is valid as long as `compiled` exists.
    """
    compiled.compile(tuple(types))
    result = compiled.overloads[tuple(types)]
    return int(result.library.get_pointer_to_function(result.fndesc.llvm_func_name))


def call_at(
    context: Any, builder: Any, address: Any, signature: Any, arguments: Sequence[Any]
) -> tuple[Any, Any]:
    """Write the call of a compiled function into an intrinsic; return its status and its result.

    `address` is that of `address_of`; `signature` is that of the function, and `arguments` are its
    arguments. The status tells whether the function has raised an exception.
    """
    convention = context.call_conv
    types = signature.return_type, signature.args
    function = builder.inttoptr(address, convention.get_function_type(*types).as_pointer())
    status, result = convention.call_function(builder, function, *types, arguments)
    return status, result
