# SPDX-License-Identifier: Apache-2.0
"""The outline of a bird from above, for every picture of birds.

Points are (across, along) over the semi-span, with across to the right and along in flight.
"""

import numpy as np

RIGHT_HALF = np.array(
    [
        (0.0, 0.15),
        (0.04, 0.11),
        (0.4, 0.1),
        (0.75, 0.02),
        (1.0, -0.12),
        (0.72, -0.1),
        (0.4, -0.1),
        (0.07, -0.13),
        (0.04, -0.22),
        (0.0, -0.23),
    ]
)
"""The right half, from nose to tail, shape (points, 2)."""

OUTLINE = np.concatenate([RIGHT_HALF, RIGHT_HALF[::-1] * (-1.0, 1.0)])
"""The whole outline, shape (points, 2)."""
