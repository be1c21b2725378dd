# SPDX-License-Identifier: Apache-2.0
"""Link models: a model computes what a bird knows from the last message of a neighbour.

A new model is a function here, or in a file of its own, and a line in `links/registry.py`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

Perceive = Callable[[float, float, float, float, float], tuple[float, float]]
"""(age, position, speed, circulation, rate) -> (position, circulation), of a neighbour in a member.

`age` is the time, in b / U_min, from the beginning of the step in which the message was sent to
the Runge-Kutta stage at which it is used. Position, speed and circulation are those in the message,
in b and U_min. `rate` is the rate of change of the circulation since the message before it. It is 0
if there is no message before it, or if the speed has noise or is rounded. The drag is computed with
the result. The function is compiled, so it takes numbers only: see `physics.compile`.
"""


@dataclass(frozen=True)
class LinkModel:
    """A way to compute what a bird knows of a neighbour from its messages."""

    name: str
    """The name as it is written in `links`."""
    perceive: Perceive
    every_stage: bool = False
    """Whether the neighbour sends at all four stages of every step, so that `perceive` gets the
    values of the present stage; otherwise it sends at stage 0 of every `interval`-th step."""
    digest: str = ""
    """The digest of the source of a model of an installed package, or ""."""
    recorded: bool = False
    """Whether only its name is known, from a bag: it can be read about, but not flown."""


def received(
    age: float, position: float, speed: float, circulation: float, rate: float
) -> tuple[float, float]:
    """Return the received values, whatever their age."""
    return position, circulation


def extrapolated(
    age: float, position: float, speed: float, circulation: float, rate: float
) -> tuple[float, float]:
    """Return the position at constant speed, and the circulation at its last rate of change.

    With a constant circulation, the error of circulation and drag would be of first order in the
    age: for short intervals, `linear` would converge no faster than `hold`.
    """
    return position + speed * age, circulation + rate * age


EXACT = LinkModel("exact", received, every_stage=True)
"""The values at the present Runge-Kutta stage, from the latest step that has arrived."""

HOLD = LinkModel("hold", received)
"""The last received state, unchanged."""

LINEAR = LinkModel("linear", extrapolated)
"""The last received state, with position and circulation extrapolated."""
