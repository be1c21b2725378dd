# SPDX-License-Identifier: Apache-2.0
"""All link models. A new one is a file of its own and a line here, or registered from outside."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from dataclasses import replace

from numba.core.errors import NumbaError

from flock_sim.core.kernel import anew, kernel
from flock_sim.core.links.exact import EXACT
from flock_sim.core.links.hold import HOLD
from flock_sim.core.links.linear import LINEAR
from flock_sim.core.links.model import Know, LinkModel
from flock_sim.errors import FlockError

MODELS = [
    EXACT,
    HOLD,
    LINEAR,
]

BUILT_IN = len(MODELS)
"""How many of them every process has; `register` adds others behind them."""

Choice = Callable[[int, float, float, float, float, float], tuple[float, float]]

NAME = re.compile(r"[a-z][a-z0-9_]*")


def register(model: LinkModel) -> None:
    """Have `model` in this process, for all flocks that are configured from now on.

    Its `know` may be a plain function; it is compiled here. Raises FlockError where it can't be, or
    where the name is taken or none.
    """
    called = f"link model {model.name!r}"
    if not NAME.fullmatch(model.name):
        raise FlockError(f"{called}: must be a letter and then a-z, 0-9 or _, such as fading")
    if model.name in [other.name for other in MODELS]:
        raise FlockError(f"{called} is there already: give the new one another name")
    MODELS.append(replace(model, know=_compiled(called, model.know)))


def _compiled(called: str, function: Know) -> Know:
    """Compile what a model knows, and try it. Raises FlockError where that fails."""
    compiled = anew(function)
    try:
        known = compiled(0.0, 0.0, 1.0, 0.5, 0.0)
    except (NumbaError, TypeError) as error:
        reason = next((line for line in str(error).splitlines()[1:] if line.strip()), str(error))
        raise FlockError(
            f"{called}: its know can't be compiled ({reason.strip()}); take numbers only, see "
            "docs/extending.md"
        ) from error
    if not (isinstance(known, tuple) and list(map(type, known)) == [float, float]):
        raise FlockError(
            f"{called}: its know gives {known!r}: must be a position and a circulation"
        )
    return compiled


@kernel
def _none(
    model: int, age: float, position: float, speed: float, circulation: float, rate: float
) -> tuple[float, float]:
    return position, circulation


def _before(
    number: int, chosen: Know, others: Choice, compiler: Callable[[Choice], Choice]
) -> Choice:
    """Return the kernel that asks model `number` where it is meant, and `others` otherwise."""

    @compiler
    def choose(
        model: int, age: float, position: float, speed: float, circulation: float, rate: float
    ) -> tuple[float, float]:
        if model == number:
            return chosen(age, position, speed, circulation, rate)
        return others(model, age, position, speed, circulation, rate)

    return choose


def choice(models: Iterable[LinkModel], compiler: Callable[[Choice], Choice] = anew) -> Choice:
    """Return the kernel of what model number `model` of `models` knows.

    It is a chain, since numba takes no tuple of functions.
    """
    chosen: Choice = _none
    for number, model in enumerate(models):
        chosen = _before(number, model.know, chosen, compiler)
    return chosen


know = choice(MODELS, kernel)
"""That of the models which every process has."""
