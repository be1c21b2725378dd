# SPDX-License-Identifier: Apache-2.0
"""The model `linear`: the last received state, with position and circulation extrapolated."""

from flock_sim.links.models import LinkModel


def perceive(
    age: float, position: float, speed: float, circulation: float, rate: float
) -> tuple[float, float]:
    """Return the position at constant speed, and the circulation at its last rate of change.

    With a constant circulation, the error of circulation and drag would be of first order in the
    age: for short intervals, `linear` would converge no faster than `hold`.
    """
    return position + speed * age, circulation + rate * age


LINEAR = LinkModel("linear", perceive)
