# SPDX-License-Identifier: Apache-2.0
"""The kernel that calls the model of a link."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import cache

from flock_sim.links.models import LinkModel, Perceive
from flock_sim.links.registry import BUILT_IN, MODELS
from flock_sim.physics.compile import anew, kernel

Choice = Callable[[int, float, float, float, float, float], tuple[float, float]]


@kernel
def _none(
    model: int, age: float, position: float, speed: float, circulation: float, rate: float
) -> tuple[float, float]:
    return position, circulation


def _before(
    number: int, chosen: Perceive, others: Choice, compiler: Callable[[Choice], Choice]
) -> Choice:
    """Return the kernel that calls `chosen` for model `number`, and `others` for other models."""

    @compiler
    def choose(
        model: int, age: float, position: float, speed: float, circulation: float, rate: float
    ) -> tuple[float, float]:
        if model == number:
            return chosen(age, position, speed, circulation, rate)
        return others(model, age, position, speed, circulation, rate)

    return choose


def choice(models: Iterable[LinkModel], compiler: Callable[[Choice], Choice] = anew) -> Choice:
    """Return the kernel that calls the perceive function of model number `model` of `models`.

    It is a chain of functions, since numba accepts no tuple of functions.
    """
    chosen: Choice = _none
    for number, model in enumerate(models):
        chosen = _before(number, _compiled(model.perceive), chosen, compiler)
    return chosen


@cache
def _compiled(perceive: Perceive) -> Perceive:
    """Return `perceive` compiled. `register` has already compiled that of registered models."""
    return perceive if hasattr(perceive, "py_func") else kernel(perceive)


perceive = choice(MODELS[:BUILT_IN], kernel)
"""The choice among the built-in models, which every process has."""
