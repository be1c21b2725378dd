# SPDX-License-Identifier: Apache-2.0
"""A link model of your own, flown over ROS 2 and checked against the reference.

    ./flock python examples/link_model.py

A bird takes what it was told of a neighbour's wake for faded, the more so the older the message is.
"""

import math
import sys

import numpy as np

from flock_sim import FlockConfiguration, LinkModel, Reference, register
from flock_tools import fly

MEMORY = 20.0
"""Time in which the trust falls to 1/e, in b / U_min."""


def perceive(
    age: float, position: float, speed: float, circulation: float, rate: float
) -> tuple[float, float]:
    """Return the neighbour's position and circulation, as this bird believes them to be."""
    return position + speed * age, circulation * math.exp(-age / MEMORY)


register(LinkModel("fading", perceive))


def main() -> int:
    """Fly with messages that are ever rarer; return 0 if over ROS all was as in the reference."""
    equal = True
    for interval in (1, 10, 30):
        links = (f"fading:interval={interval}",)
        flock = FlockConfiguration(birds=5, t_max=1000.0, record_every=10, links=links)
        flight = fly(flock)
        reference = np.stack([recorded.speed for recorded in Reference(flock).fly()])
        equal &= np.array_equal(flight.speed, reference)
        speed = float(flight.speed[-1].mean())
        print(f"a message every {interval:2} steps: speed {speed:.12f} U_min at the end")
    print(f"equal to the reference to the bit: {'yes' if equal else 'NO'}")
    return 0 if equal else 1


if __name__ == "__main__":
    sys.exit(main())
