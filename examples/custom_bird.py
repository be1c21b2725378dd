# SPDX-License-Identifier: Apache-2.0
"""Birds of your own: each pulls itself to a wanted speed, and to a wanted gap behind the next one.

    ./flock python examples/custom_bird.py

prints the gaps and the speed in which such a flock ends.
"""

import numpy as np

from flock_sim import BirdNode, FlockConfiguration, Perception
from flock_tools import fly

FLOCK = FlockConfiguration(birds=5, t_max=1000.0, record_every=10)
LEADER = (FLOCK.birds + 1) // 2

SPEED, GAP = 1.2, 0.8
"""What is wanted, in U_min and b."""

DAMPING, STIFFNESS = 0.5, 0.02
"""Force per speed and per gap that is off, in rho b^2 U_min and rho b U_min^2."""


class GapKeeper(BirdNode):
    """A bird that is pulled forward where it is too slow, or the bird ahead of it too far."""

    def control(self, known: Perception) -> np.ndarray:
        """Return the force, one number a member."""
        force = DAMPING * (SPEED - known.speed)
        if known.bird != LEADER:
            ahead = known.bird + (1 if known.bird < LEADER else -1)
            gap = known.positions[known.neighbours.index(ahead)] - known.position
            force += STIFFNESS * (gap - GAP)
        return force


def main() -> None:
    """Fly, and print what came of it."""
    end = fly(FLOCK, bird=GapKeeper).isel(time=-1, member=0)
    gaps = np.diff(end.position.sel(bird=slice(1, LEADER)))
    print("gaps, tail to leader:", *(f"{gap:.9f}" for gap in gaps), f"b (wanted: {GAP})")
    print(f"speed: {float(end.speed.mean()):.9f} U_min (wanted: {SPEED})")


if __name__ == "__main__":
    main()
