# SPDX-License-Identifier: Apache-2.0
"""The distribution of gaps in gusts, beyond the linear theory, for nearest-neighbour coupling.

The drags of a pair of neighbours sum to a constant, so a gap g acts as a spring between two masses,
whose force is -Phi'(g), with the stiffness Phi''(g) = Gamma_i Gamma_{i+1} f'(|g|) / (4 pi). If all
birds had equal masses and were damped by forces -m c (U - U*), white accelerations would keep this
chain of springs at the temperature T = m STD^2 / (2 c), by the fluctuation-dissipation theorem.
Then the stationary distribution is that of Gibbs, in which all gaps are independent:

    p(g) ~ exp(-Phi(g) / T).

In a flock the damping of a bird also depends on the speeds of its neighbours, since drags go as
1 / (U_i U_j), and masses and dampings may differ. Then no common temperature exists. The estimate
uses the temperature with which the linear theory holds for the gap, T = Phi''(g*) var(g), with the
exact variance of the linear theory. So

    p(g* + d) ~ exp(-psi(d) / var(g)),    psi(d) = int_0^d (d - t) f'(|g* + t|) dt / f'(|g*|),

which has the exact limit of weak gusts, is exact for equal masses and simple damping at any
strength, and otherwise takes from the linear theory how dampings mix. It neglects that the strength
of the interaction and the damping change with speed. Phi grows linearly far from the steady state
(the drag of a bird in the full wake, or without a wake), so p has exponential tails.
"""

from __future__ import annotations

from math import exp, hypot, inf, isfinite, nan, sqrt

import numpy as np

from flock_sim.physics.aerodynamics import ahead_integral_and_slope
from flock_sim.physics.arrays import FloatArray
from flock_sim.physics.compile import kernel
from flock_sim.physics.flock import Flock

NODES, WEIGHTS = np.polynomial.legendre.leggauss(10)

NEGLIGIBLE = 60.0
"""Value of psi / var(g) beyond which p is negligible, in any moment."""

MOST_PANELS = 2000


def gap_distributions(flock: Flock, spacing: FloatArray, std: FloatArray) -> FloatArray:
    """Return the mean and the standard deviation of each gap, in b, shape (2, birds - 1).

    `flock` has one member and nearest-neighbour coupling. `spacing` are its steady gaps, `std` the
    standard deviations of the linear theory, both (birds - 1,) in b. The mean differs from the
    steady gap, since springs are softer on one side.
    """
    gaps = np.empty((2, flock.birds - 1))
    half = flock.half_span[:, 0]
    for k in range(flock.birds - 1):
        gaps[:, k] = _moments(
            float(spacing[k]), float(flock.lateral[k, 0]), half[k], half[k + 1], float(std[k])
        )
    return gaps


@kernel
def _moments(
    spacing: float, lateral: float, half: float, other_half: float, std: float
) -> tuple[float, float]:
    """Return mean and standard deviation of p(g), in b; nan if `std` is not finite.

    Panels of Gauss's rule go outwards from the steady gap. They are short against the distances
    over which the spring and p change.
    """
    if not isfinite(std):
        return nan, nan
    if std == 0.0:
        return spacing, 0.0
    variance = std * std
    sharp = lateral - half - other_half
    unit = ahead_integral_and_slope(abs(spacing), lateral, half, other_half)[1]
    norm, first, second = 0.0, 0.0, 0.0
    for side in (-1.0, 1.0):
        start, psi, force = 0.0, 0.0, 0.0
        for _ in range(MOST_PANELS):
            smooth = 0.4 * hypot(spacing + side * start, sharp)
            falls = 2.0 * variance / force if force > 0.0 else inf
            width = min(smooth, 0.5 * max(std, 0.2 * start), falls)
            for n in range(len(NODES) + 1):
                # the nodes of the panel, and then its end
                part = 0.5 * width * (1.0 + NODES[n]) if n < len(NODES) else width
                energy, pull = psi + force * part, force
                for k in range(len(NODES)):
                    place = 0.5 * part * (1.0 + NODES[k])
                    at = abs(spacing + side * (start + place))
                    slope = ahead_integral_and_slope(at, lateral, half, other_half)[1] / unit
                    weight = 0.5 * part * WEIGHTS[k] * slope
                    energy += weight * (part - place)
                    pull += weight
                if n < len(NODES):
                    moved = side * (start + part)
                    density = 0.5 * width * WEIGHTS[n] * exp(-energy / variance)
                    norm += density
                    first += density * moved
                    second += density * moved * moved
                else:
                    start, psi, force = start + width, energy, pull
            if psi > NEGLIGIBLE * variance:
                break
    mean = first / norm
    return spacing + mean, sqrt(second / norm - mean * mean)
