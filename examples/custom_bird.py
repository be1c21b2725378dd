# SPDX-License-Identifier: Apache-2.0
"""Birds of your own: each pulls itself to a wanted speed, and to a wanted gap behind the next one.

    ./flock python examples/custom_bird.py

prints the gaps and the speed in which such a flock ends.
"""

import numpy as np

from flock_sim.core import formation
from flock_sim.core.configuration import FlockConfiguration
from flock_sim.core.steering import View
from flock_sim.nodes.bird import BirdNode
from flock_sim.testing import fly_in_process

FLOCK = FlockConfiguration(birds=5, t_max=1000.0, record_every=10)
LEADER = formation.leader(FLOCK.birds)

SPEED, GAP = 1.2, 0.8
"""What is wanted, in U_min and b."""

DAMPING, STIFFNESS = 0.5, 0.02
"""Force per speed and per gap that is off, in rho b^2 U_min and rho b U_min^2."""


class GapKeeper(BirdNode):
    """A bird that is pulled forward where it is too slow, or the bird ahead of it too far."""

    def control(self, view: View) -> np.ndarray:
        """Return the force, one number a member."""
        force = DAMPING * (SPEED - view.speed)
        if view.bird != LEADER:
            ahead = view.bird + (1 if view.bird < LEADER else -1)
            gap = view.positions[view.neighbours.index(ahead)] - view.position
            force += STIFFNESS * (gap - GAP)
        return force


def main() -> None:
    """Fly, and print what came of it."""
    end = fly_in_process(FLOCK, bird=GapKeeper).isel(time=-1, member=0)
    gaps = np.diff(end.position.sel(bird=slice(1, LEADER)))
    print("gaps, tail to leader:", *(f"{gap:.9f}" for gap in gaps), f"b (wanted: {GAP})")
    print(f"speed: {float(end.speed.mean()):.9f} U_min (wanted: {SPEED})")


if __name__ == "__main__":
    main()
