# SPDX-License-Identifier: Apache-2.0
"""The model `exact`: the neighbour's values at the present Runge-Kutta stage."""

from flock_sim.links.models import LinkModel


def perceive(
    age: float, position: float, speed: float, circulation: float, rate: float
) -> tuple[float, float]:
    """Return the neighbour's message of this stage, from the latest step that has arrived."""
    return position, circulation


EXACT = LinkModel("exact", perceive, every_stage=True)
