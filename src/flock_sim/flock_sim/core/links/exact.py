# SPDX-License-Identifier: Apache-2.0
"""The link of lockstep: the neighbour's values at this very Runge-Kutta stage."""

from flock_sim.core.kernel import kernel
from flock_sim.core.links.model import LinkModel


@kernel
def know(
    age: float, position: float, speed: float, circulation: float, rate: float
) -> tuple[float, float]:
    """Return what the neighbour has sent at this stage, of the latest step that has arrived."""
    return position, circulation


EXACT = LinkModel("exact", know, every_stage=True)
