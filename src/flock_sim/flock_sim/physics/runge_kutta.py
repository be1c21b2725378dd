# SPDX-License-Identifier: Apache-2.0
"""The Runge-Kutta method, as data; `stage_kernels.move` applies it."""

import numpy as np

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
