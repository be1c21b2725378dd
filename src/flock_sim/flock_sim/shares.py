# SPDX-License-Identifier: Apache-2.0
"""How the birds of a flock are shared out over processes."""

import itertools


def shares(birds: int, processes: int) -> list[list[int]]:
    """Return the birds 1..`birds` of each process: neighbours together, as even as can be."""
    bounds = [k * birds // processes for k in range(processes + 1)]
    return [list(range(low + 1, high + 1)) for low, high in itertools.pairwise(bounds)]
