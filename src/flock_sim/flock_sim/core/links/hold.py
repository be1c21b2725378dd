# SPDX-License-Identifier: Apache-2.0
"""The last state received, frozen."""

from flock_sim.core.kernel import kernel
from flock_sim.core.links.model import LinkModel


@kernel
def know(
    age: float, position: float, speed: float, circulation: float, rate: float
) -> tuple[float, float]:
    """Return what was received, however old it is."""
    return position, circulation


HOLD = LinkModel("hold", know)
