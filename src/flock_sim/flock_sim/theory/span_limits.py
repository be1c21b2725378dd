# SPDX-License-Identifier: Apache-2.0
"""Stability limits: the span ratios of one bird with which a flock holds together."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.physics.arrays import FloatArray, IntArray
from flock_sim.physics.flock import Flock
from flock_sim.theory import limit_search
from flock_sim.theory.equilibrium import Equilibrium, equilibrium
from flock_sim.theory.limit_search import Limits, Trial, limits_of_existence, modified

LEAST_SUM = 1.0 + 1e-6
"""Least sum of the span ratios of neighbours."""


def modified_birds(configuration: FlockConfiguration) -> list[int]:
    """Return the birds to modify: one wing if the flock is its own mirror image, else all."""
    ratio = configuration.span_ratio
    mirrored = np.array_equal(ratio, ratio[::-1])
    last = (configuration.birds + 1) // 2 if mirrored else configuration.birds
    return list(range(1, last + 1))


def exact_limits(
    configuration: FlockConfiguration, birds: Sequence[int], low: float, high: float
) -> list[Limits]:
    """Return the limits of lambda of each of `birds` in [low, high], where steady states exist.

    They are exact to about 1e-13. `configuration` has one member.
    """

    def steady_states(span_ratio: FloatArray) -> tuple[Flock, Equilibrium]:
        flock = Flock.of(configuration, span_ratio)
        return flock, equilibrium(flock)

    present = configuration.span_ratio[:, 0]
    lowest = [_lowest(present, bird, low) for bird in birds]
    return limits_of_existence(steady_states, present, birds, lowest, high)


def search(
    configuration: FlockConfiguration,
    birds: Sequence[int],
    low: float,
    high: float,
    resolution: float,
    trial: Trial,
    grid: int = 1,
    sections: int = 2,
) -> list[Limits]:
    """Return the limits of lambda of each of `birds` in [low, high], by `limit_search.search`.

    With small neighbours, the interval starts at the ratio at which the vortices are still apart.
    """
    present = configuration.span_ratio[:, 0]
    lowest = [_lowest(present, bird, low) for bird in birds]
    return limit_search.search(present, birds, lowest, high, resolution, trial, grid, sections)


def _lowest(present: FloatArray, bird: int, low: float) -> float:
    """Return the smallest lambda of `bird` to try, at least `low`; `present` has shape (birds,)."""
    beside = present[[k for k in (bird - 2, bird) if 0 <= k < len(present)]]
    return max(low, float(LEAST_SUM - beside.min(initial=np.inf)))


def modified_span_ratios(
    configuration: FlockConfiguration,
    birds: Sequence[int] | IntArray,
    ratios: Sequence[float] | FloatArray,
) -> FloatArray:
    """Return the span ratios with one modified bird per member, shape (birds, members)."""
    return modified(configuration.span_ratio[:, 0], birds, ratios)
