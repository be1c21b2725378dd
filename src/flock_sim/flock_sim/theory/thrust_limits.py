# SPDX-License-Identifier: Apache-2.0
"""Thrust limits: how much thrust one bird may lose or add before its flock parts."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.physics.arrays import FloatArray
from flock_sim.physics.flock import Flock
from flock_sim.theory.equilibrium import Equilibrium, equilibrium
from flock_sim.theory.limit_search import Limits, limits_of_existence


def exact_thrust_limits(
    configuration: FlockConfiguration, birds: Sequence[int], low: float, high: float
) -> list[Limits]:
    """Return the limits of T/T_0 of each of `birds` in [low, high], where steady states exist.

    T_0 is the thrust of that bird in the model, lambda^4 k (U_0^2 + U_0^-2); all other birds keep
    theirs. The limits are exact to about 1e-13. `configuration` has one member.
    """
    given = Flock.of(configuration)

    def steady_states(thrust_ratio: FloatArray) -> tuple[Flock, Equilibrium]:
        flock = given.select(np.zeros(thrust_ratio.shape[1], dtype=np.int64))
        return flock, equilibrium(flock, thrust_ratio)

    present = np.ones(configuration.birds)
    return limits_of_existence(steady_states, present, birds, [low] * len(birds), high)
