# SPDX-License-Identifier: Apache-2.0
"""Steady states of the core, and what tests of theory measure of them."""

import mpmath
import numpy as np
from mpmath import mp

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.physics.flock import Flock
from flock_sim.theory.equilibrium import Equilibrium, equilibrium
from support.steady_flocks import forces, positions_of


def flock_of(birds, ratios=None, **parameters) -> Flock:
    """The flock of a configuration; `ratios` (birds, members) or (birds,) replace its ratios."""
    ratios = None if ratios is None else np.array(ratios, dtype=float).reshape(birds, -1)
    return Flock.of(FlockConfiguration(birds=birds, **parameters), ratios)


def steady(birds, ratios=None, **parameters) -> Equilibrium:
    """The steady states of `flock_of`."""
    return equilibrium(flock_of(birds, ratios, **parameters))


def largest_force(spacing, speed, ratios, coupling="nearest", **how):
    """The largest force on a bird of one flock, in units of k, in 30 digits; `how` as `forces`."""
    with mpmath.workdps(30):
        force = forces(
            [mp.mpf(x) for x in positions_of(spacing)],
            [mp.mpf(speed)] * len(ratios),
            [mp.mpf(ratio) for ratio in ratios],
            coupling,
            of=mp,
            **how,
        )
        return max(abs(value) for value in force)


def rate_and_frequency(signal, interval):
    """mu of y = Re(c exp(mu t)), from samples: y'' = (z + z*) y' - z z* y, z = exp(mu interval)."""
    table = np.column_stack([signal[1:-1], signal[:-2]])
    twice, square = np.linalg.lstsq(table, signal[2:], rcond=None)[0]
    z = 0.5 * (twice + np.emath.sqrt(twice**2 + 4.0 * square))
    return np.log(z) / interval
