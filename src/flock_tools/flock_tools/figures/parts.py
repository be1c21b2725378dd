# SPDX-License-Identifier: Apache-2.0
"""The parts of a flock that has come apart: birds that are close to each other along the flight."""

from __future__ import annotations

import numpy as np

from flock_sim.physics.arrays import FloatArray, IntArray


def parts(along: FloatArray, widest: float, longest: float) -> list[IntArray]:
    """Return the indices of the birds of each part, from the last part to the first.

    `along` has shape (birds,), in b. Consecutive birds of a part are at most `widest` apart, and
    its length is at most `longest`. A bird without a finite position has no part.
    """
    order = np.argsort(along, kind="stable")
    order = order[np.isfinite(along[order])]
    found: list[list[int]] = []
    for i in order:
        if found:
            first, last = along[found[-1][0]], along[found[-1][-1]]
            if along[i] - last <= widest and along[i] - first <= longest:
                found[-1].append(int(i))
                continue
        found.append([int(i)])
    return [np.array(part) for part in found]
