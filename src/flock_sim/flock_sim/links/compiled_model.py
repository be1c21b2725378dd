# SPDX-License-Identifier: Apache-2.0
"""The kernel that calls the model of a link, by its code.

The code of a built-in model is its index in MODELS, and the kernel contains its function. That of a
registered model is the address of its compiled function. So no kernel is compiled again for it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import cache
from typing import Any

import numpy as np

from flock_sim.links.models import Perceive
from flock_sim.links.registry import BUILT_IN, MODELS
from flock_sim.physics.arrays import IntArray
from flock_sim.physics.compile import anew_for_kernels, kernel
from flock_sim.physics.compiler import numba
from flock_sim.physics.native_call import ADDRESS, address_of, call_at

Choice = Callable[[int, float, float, float, float, float], tuple[float, float]]

_NUMBER = numba.types.float64
_PERCEIVE: Any = numba.types.UniTuple(_NUMBER, 2)(*5 * [_NUMBER])
"""The type of a compiled perceive function."""


def codes(models: Iterable[int]) -> IntArray:
    """Return the codes of all MODELS, shape (models,), after compiling `models`, indices in it.

    The code of another model that is not built in is -1, and must not be called.
    """
    result = np.arange(len(MODELS))
    result[BUILT_IN:] = -1
    for model in {*models}:
        if model >= BUILT_IN and not MODELS[model].recorded:
            result[model] = _compiled(MODELS[model].perceive)[0]
    return result


@cache
def _compiled(perceive: Perceive) -> tuple[int, Perceive]:
    """Return the address of a compiled function, and the function, which must live as long."""

    def of_floats(
        age: float, position: float, speed: float, circulation: float, rate: float
    ) -> tuple[float, float]:
        position, circulation = perceive(age, position, speed, circulation, rate)
        return float(position), float(circulation)

    compiled = anew_for_kernels(of_floats)
    return address_of(compiled, _PERCEIVE.args), compiled


@numba.extending.intrinsic
def _call(
    _: Any, code: Any, age: Any, position: Any, speed: Any, circulation: Any, rate: Any
) -> Any:
    """Call the perceive function at an address. What it raises is raised here."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        status, known = call_at(context, builder, arguments[0], _PERCEIVE, arguments[1:])
        with numba.core.cgutils.if_unlikely(builder, status.is_error):
            context.call_conv.return_status_propagate(builder, status)
        return known

    return _PERCEIVE.return_type(ADDRESS, *_PERCEIVE.args), generate


@kernel
def _registered(
    code: int, age: float, position: float, speed: float, circulation: float, rate: float
) -> tuple[float, float]:
    known: tuple[float, float] = _call(code, age, position, speed, circulation, rate)
    return known


def _before(number: int, chosen: Perceive, others: Choice) -> Choice:
    """Return the kernel that calls `chosen` for code `number`, and `others` for other codes."""

    @kernel
    def choose(
        code: int, age: float, position: float, speed: float, circulation: float, rate: float
    ) -> tuple[float, float]:
        if code == number:
            return chosen(age, position, speed, circulation, rate)
        return others(code, age, position, speed, circulation, rate)

    return choose


def _choice() -> Choice:
    """Return a chain of functions, since numba accepts no tuple of functions."""
    chosen: Choice = _registered
    for number, model in enumerate(MODELS[:BUILT_IN]):
        chosen = _before(number, kernel(model.perceive), chosen)
    return chosen


perceive = _choice()
"""(code, age, position, speed, circulation, rate) -> (position, circulation), as the model of this
code computes them. What a registered model raises is raised here."""
