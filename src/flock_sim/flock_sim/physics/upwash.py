# SPDX-License-Identifier: Apache-2.0
"""The vertical velocity that a horseshoe vortex induces at any point.

The paper gives it in the plane of the wings, Eqs. (vz0) and (vzpm); here a point may lie above or
below this plane. Its integral along the bound segment of another bird is the interaction integral
of `aerodynamics`.
"""

from __future__ import annotations

from math import pi

import numpy as np

from flock_sim.physics.arrays import FloatArray


def upwash(
    behind: FloatArray | float,
    across: FloatArray | float,
    above: FloatArray | float,
    half: FloatArray | float,
    circulation: FloatArray | float,
) -> FloatArray:
    """Return the vertical velocity that a horseshoe induces at a point, in U_min; upwash is > 0.

    The point is `behind` the bound vortex (in front of it: < 0), `across` from its middle and
    `above` it; `half` is the vortex half-span a. All are in b, `circulation` in b U_min, and
    broadcast together. On a vortex the result is not finite. Eqs. (vz0), (vzpm) where `above` = 0.
    """
    behind, across, above = np.broadcast_arrays(behind, across, above)
    square, height = behind * behind, above * above
    right, left = across + half, across - half
    with np.errstate(divide="ignore", invalid="ignore"):
        to_right = np.sqrt(square + right * right + height)
        to_left = np.sqrt(square + left * left + height)
        # On its own line, beside the segment, the bound vortex induces nothing.
        lever = np.where(behind == 0.0, 0.0, behind / (square + height))
        bound = lever * (right / to_right - left / to_left)
        trailing = right / (right * right + height) * (1.0 + behind / to_right) - left / (
            left * left + height
        ) * (1.0 + behind / to_left)
    return np.asarray(-np.asarray(circulation) / (4.0 * pi) * (bound + trailing))


def flock_upwash(
    point: FloatArray,
    position: FloatArray,
    lateral: FloatArray,
    half: FloatArray,
    circulation: FloatArray,
) -> FloatArray:
    """Return the vertical velocity that all birds together induce, in U_min.

    `point` has shape (..., 3): position, lateral and height, in b; the birds' quantities have shape
    (birds,), the result (...).
    """
    total = np.zeros(point.shape[:-1])
    for i in range(len(position)):
        total += upwash(
            position[i] - point[..., 0],
            point[..., 1] - lateral[i],
            point[..., 2],
            half[i],
            circulation[i],
        )
    return total
