# SPDX-License-Identifier: Apache-2.0
"""All link models. A new one is a file of its own, and a line here."""

from __future__ import annotations

from collections.abc import Callable

from flock_sim.core.kernel import kernel
from flock_sim.core.links.exact import EXACT
from flock_sim.core.links.hold import HOLD
from flock_sim.core.links.linear import LINEAR
from flock_sim.core.links.model import Know

MODELS = (
    EXACT,
    HOLD,
    LINEAR,
)

Choice = Callable[[int, float, float, float, float, float], tuple[float, float]]


@kernel
def _none(
    model: int, age: float, position: float, speed: float, circulation: float, rate: float
) -> tuple[float, float]:
    return position, circulation


def _before(number: int, chosen: Know, others: Choice) -> Choice:
    """Return the kernel that asks model `number` where it is meant, and `others` otherwise."""

    @kernel
    def choose(
        model: int, age: float, position: float, speed: float, circulation: float, rate: float
    ) -> tuple[float, float]:
        if model == number:
            return chosen(age, position, speed, circulation, rate)
        return others(model, age, position, speed, circulation, rate)

    return choose


know: Choice = _none
"""What model number `model` of MODELS knows: a chain, since numba takes no tuple of functions."""
for _number, _model in enumerate(MODELS):
    know = _before(_number, _model.know, know)
