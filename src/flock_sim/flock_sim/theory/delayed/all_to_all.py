# SPDX-License-Identifier: Apache-2.0
"""The steady state of all-to-all coupling in which birds see each other with a constant lag.

As in `nearest`, each bird sees the others d = U* tau behind their positions. The forces are
not a gradient, since two birds do not see each other at opposite distances. Multiplied by u / k,
with u = U*^2, they are

    G_j = u R_j(u) - (s / 2) sum_i lambda_i^2 lambda_j^2 I(x_i - x_j - d),

and Newton's method for positions and speed finds the state in which all are 0. A state with
u >= H_0 lambda^2 for every bird is unique. Proof: compare two such states, and take the bird that
is further ahead in the faster state by the most. In the faster state it sees all others further
behind, also because of the lag, so it saves less. But at the higher speed it needs more.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from flock_sim.errors import RunFailed
from flock_sim.physics import formation
from flock_sim.physics.aerodynamics import ahead_integral_and_slope, split_drag
from flock_sim.physics.arrays import FloatArray
from flock_sim.physics.compile import kernel
from flock_sim.physics.flock import Flock
from flock_sim.theory.equilibrium import equilibrium
from flock_sim.theory.steady_speed import balance

MOST_ITERATIONS = 60
MOST_HALVINGS = 40
MOST_STAGES = 400

ROUNDING = 1e-14
"""Largest G_j, per bird, that is rounding: pairs save about 0.5."""

FIRST_STAGE = 0.02
"""Lag of the first stage, in b / U_min: small against the 0.2 b over which the drag changes."""


def delayed_all_to_all(flock: Flock, lag: float) -> tuple[FloatArray, float]:
    """Return spacings (birds - 1,) in b and speed U* of a flock of one member at `lag` tau >= 0.

    Newton's method follows the state from that without a lag, in stages of growing lag. It also
    works for nearest-neighbour coupling. The result is nan if no state without a lag exists, or if
    no state with u >= H_0 lambda^2 can be followed. Raises RunFailed if stages become too short.
    """
    start = equilibrium(flock)
    ratios = flock.span_ratio[:, 0]
    spacing, speed = start.spacing[:, 0], float(start.speed[0])
    nothing = np.full(flock.birds - 1, np.nan)
    reached, stage = 0.0, min(FIRST_STAGE, lag)
    for _ in range(MOST_STAGES):
        if not speed**2 >= flock.scales.cruise_ratio * ratios.max() ** 2:
            return nothing, float("nan")
        if reached >= lag:
            return spacing, speed
        following = min(lag, reached + stage)
        found = _newton(flock, following, spacing, speed)
        if found is None:
            stage *= 0.25
        else:
            spacing, speed = found
            reached, stage = following, 2.0 * stage
    raise RunFailed(
        f"Newton's method followed the steady state to lag {reached:g} and no further in "
        f"{MOST_STAGES} stages; it may end there"
    )


def _newton(
    flock: Flock, lag: float, spacing: FloatArray, speed: float
) -> tuple[FloatArray, float] | None:
    """Return the state at `lag` near the given spacing and speed; None if it isn't found."""
    birds = flock.birds
    rest, slopes = np.empty(birds), np.empty((birds, birds + 1))

    def forces(unknown: FloatArray) -> float:
        _fill_forces(
            formation.positions(unknown[:-1, np.newaxis])[:, 0],
            unknown[-1],
            lag,
            flock.span_ratio[:, 0].copy(),
            flock.half_span[:, 0].copy(),
            flock.pairs,
            flock.lateral[:, 0].copy(),
            flock.even[:, 0].copy(),
            flock.scales.cruise_ratio,
            flock.scales.saving_ratio,
            rest,
            slopes,
        )
        return float(np.abs(rest).max())

    unknown = np.append(spacing, speed)
    behind = formation.positions_by_gaps(birds)
    size = forces(unknown)
    for _ in range(MOST_ITERATIONS):
        matrix = np.column_stack([slopes[:, :birds] @ behind, slopes[:, birds]])
        try:
            step = np.linalg.solve(matrix, -rest)
        except np.linalg.LinAlgError:
            return None
        share, smaller = 1.0, np.inf
        for _ in range(MOST_HALVINGS):
            trial = unknown + share * step
            smaller = forces(trial) if trial[-1] > 0.0 else np.inf
            if smaller < size:
                break
            share *= 0.5
        if not smaller < size:
            break
        unknown, size = trial, smaller
    return (unknown[:-1], float(unknown[-1])) if size <= ROUNDING * birds else None


@kernel
def _fill_forces(
    position: FloatArray,
    speed: float,
    lag: float,
    span_ratio: FloatArray,
    half_span: FloatArray,
    pairs: npt.NDArray[np.int64],
    lateral: FloatArray,
    even: FloatArray,
    cruise_ratio: float,
    strength: float,
    rest: FloatArray,
    slopes: FloatArray,
) -> None:
    """Fill `rest`, G (birds,), and `slopes`, dG/d(positions, speed) (birds, birds + 1)."""
    birds = len(position)
    square = speed * speed
    slopes[:] = 0.0
    for j in range(birds):
        ratio = span_ratio[j] * span_ratio[j]
        rest[j] = square * balance(span_ratio[j], square, cruise_ratio)
        slopes[j, birds] = 4.0 * speed * ratio * (ratio * cruise_ratio - square)
    for k in range(pairs.shape[0]):
        for side in range(2):
            i, j = pairs[k, side], pairs[k, 1 - side]
            weight = 0.5 * strength * (span_ratio[i] * span_ratio[j]) ** 2
            seen = position[i] - position[j] - speed * lag
            ahead, slope = ahead_integral_and_slope(
                abs(seen), lateral[k], half_span[i], half_span[j]
            )
            rest[j] -= split_drag(seen, weight, ahead, even[k])[0]
            slopes[j, i] += weight * slope
            slopes[j, j] -= weight * slope
            slopes[j, birds] -= weight * slope * lag
