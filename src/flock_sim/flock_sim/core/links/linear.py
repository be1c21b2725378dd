# SPDX-License-Identifier: Apache-2.0
"""The last state received, moved on at its speed, and its circulation as it has changed."""

from flock_sim.core.kernel import kernel
from flock_sim.core.links.model import LinkModel


@kernel
def know(
    age: float, position: float, speed: float, circulation: float, rate: float
) -> tuple[float, float]:
    """Return where the neighbour is if it has kept its speed, and what its circulation has become.

    A circulation left as it was would be wrong by the first order of the age, and so would the
    drag: for short intervals, `linear` would converge no faster than `hold`.
    """
    return position + speed * age, circulation + rate * age


LINEAR = LinkModel("linear", know)
