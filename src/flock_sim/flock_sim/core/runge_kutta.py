# SPDX-License-Identifier: Apache-2.0
"""The Runge-Kutta method, as data, and the one function that applies it."""

import numpy as np

from flock_sim.core.kernel import FloatArray, kernel

STAGES = 4

# Butcher's tableau of the classical method: row s < 4 gives the value at stage s from the slopes of
# the stages before it, the last row gives the value at the end of the step.
TABLEAU = np.array(
    [
        [0.0, 0.0, 0.0, 0.0],
        [0.5, 0.0, 0.0, 0.0],
        [0.0, 0.5, 0.0, 0.0],
        [0.0, 0.0, 1.0, 0.0],
        [1.0 / 6.0, 1.0 / 3.0, 1.0 / 3.0, 1.0 / 6.0],
    ]
)

NODES = TABLEAU[:STAGES].sum(axis=1)
"""The time of each stage from the beginning of the step, in steps."""


@kernel
def stage_value(start: float, dt: float, slopes: FloatArray, row: int, k: int) -> float:
    """Return the value of quantity `k` at stage `row`, or at the end of the step for row 4.

    `start` is its value at the beginning of the step, `slopes` has shape (stages, quantities).
    """
    total = 0.0
    for stage in range(row):
        total += TABLEAU[row, stage] * slopes[stage, k]
    return start + dt * total
