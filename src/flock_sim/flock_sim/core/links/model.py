# SPDX-License-Identifier: Apache-2.0
"""What a link model is: what a bird makes of the last message that it has of a neighbour."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

Know = Callable[[float, float, float, float, float], tuple[float, float]]
"""(age, position, speed, circulation, rate) -> (position, circulation), of a neighbour in a member.

`age` is the time, in b / U_min, from the beginning of the step in which the message was sent to
the Runge-Kutta stage at which it is used; position, speed and circulation are what the message
says, in b and U_min; `rate` is how fast the circulation has changed since the message before it, 0
where there is none, or where noise or rounding of the speed would be all that it shows. The result
is what the drag is computed with. It is compiled: numbers only, see `core.kernel`.
"""


@dataclass(frozen=True)
class LinkModel:
    """A way to know a neighbour from what it has sent."""

    name: str
    """As it is written in `links`."""
    know: Know
    every_stage: bool = False
    """Whether the neighbour sends at all four stages of every step, and `know` is given what was
    sent at the stage at hand; otherwise at stage 0 of every `interval`-th step."""
