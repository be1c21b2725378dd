# SPDX-License-Identifier: Apache-2.0
"""The model `hold`: the last received state, unchanged."""

from flock_sim.links.models import LinkModel


def perceive(
    age: float, position: float, speed: float, circulation: float, rate: float
) -> tuple[float, float]:
    """Return the received values, whatever their age."""
    return position, circulation


HOLD = LinkModel("hold", perceive)
