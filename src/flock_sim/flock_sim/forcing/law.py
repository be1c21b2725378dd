# SPDX-License-Identifier: Apache-2.0
"""Laws: functions of numbers that compute the force on a bird besides thrust and drag.

A law is a plain function, which is compiled. It takes, by their names, any of the GIVEN arguments;
its other arguments are its parameters. It returns the force, or a tuple of the force and a tuple of
the rates of change of its own state:

    def cruise(bird, state, speed=1.03, gain=0.01, integral=1e-4):
        error = speed - bird.speed
        return gain * error + integral * state[0], (error,)
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any, NamedTuple

from flock_sim.errors import FlockError

if TYPE_CHECKING:
    from flock_sim.physics.arrays import FloatArray, IntArray

Law = Callable[..., Any]
"""(given arguments, parameters) -> force, or (force, (rate of state[0], ...)).

The force is forward, in rho b^2 U_min^2.
"""

GIVEN = ("bird", "neighbours", "time", "state", "step_state", "noise")
"""The arguments that a law gets if it names them:

- `bird`, a `Bird`, and `neighbours`, a `Neighbours`: the values of one member at this stage;
- `time`: that of the Runge-Kutta stage, in b / U_min;
- `state`: the law's own numbers, at this stage, shape (numbers,);
- `step_state`: the same at the beginning of the step;
- `noise`: two independent numbers of the standard normal distribution, shape (2,), which are drawn
  anew at each step for each bird. Members with equal seeds get the same ones.
"""

SEED = "seed"
"""The parameter that seeds `noise`."""


class Bird(NamedTuple):
    """A bird and its present values, as a law gets them."""

    number: int
    """1..N."""
    leader: int
    """The number of the leader of the flock."""
    span_ratio: float
    mass: float
    """m_j, in rho b^3."""
    thrust: float
    """T_j, in rho b^2 U_min^2, without any force of a law."""
    position: float
    """x_j, in b."""
    speed: float
    """U_j, in U_min."""
    circulation: float
    """Gamma_j, in b U_min."""


class Neighbours(NamedTuple):
    """The neighbours of a bird, in ascending order, as it knows them by its links.

    All arrays have shape (neighbours,). Nothing is known of a neighbour with circulation 0.
    """

    number: IntArray
    lateral: FloatArray
    """y of the neighbour minus y of the bird, in b; negative on the left."""
    position: FloatArray
    speed: FloatArray
    """The speed in the last message that has arrived, in U_min."""
    circulation: FloatArray


@dataclass(frozen=True)
class Signature:
    """The arguments of a law."""

    given: tuple[str, ...]
    """Those of GIVEN that it takes."""
    parameters: dict[str, float | None]
    """Its other arguments with their defaults; None: there is no default."""

    @property
    def seeded(self) -> bool:
        """Whether it takes random numbers."""
        return "noise" in self.given


@cache
def signature_of(law: Law) -> Signature:
    """Return the arguments of a law. Raises FlockError if it can't be a law."""
    given, parameters = [], dict[str, float | None]()
    try:
        arguments = inspect.signature(law).parameters.values()
    except (TypeError, ValueError):
        raise FlockError("must be a function") from None
    for argument in arguments:
        if argument.kind is not inspect.Parameter.POSITIONAL_OR_KEYWORD:
            raise FlockError(
                f"its argument {argument} must have a name of its own, without *, ** or /"
            )
        default = argument.default
        if argument.name in GIVEN:
            given.append(argument.name)
        elif default is inspect.Parameter.empty:
            parameters[argument.name] = None
        elif isinstance(default, int | float) and not isinstance(default, bool):
            parameters[argument.name] = float(default)
        else:
            raise FlockError(
                f"the default of its parameter {argument.name!r} is {default!r}: must be a number"
            )
    return Signature(tuple(given), parameters)
