# SPDX-License-Identifier: Apache-2.0
"""The steady state of all-to-all coupling at a constant lag, against the chain and the forces."""

import mpmath
import numpy as np
import pytest
from mpmath import mp

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.physics.flock import Flock
from flock_sim.theory.delay_stability import crossings, growth
from flock_sim.theory.delayed_all_to_all import delayed_all_to_all
from flock_sim.theory.delayed_nearest import delayed_nearest
from flock_sim.theory.equilibrium import equilibrium
from support.steady_flocks import across, drag, positions_of, random_ratios, surplus


def flock_of(birds, ratios=None, coupling="all"):
    ratios = np.ones((birds, 1)) if ratios is None else ratios
    return Flock.of(FlockConfiguration(birds=birds, coupling=coupling), ratios)


@pytest.mark.parametrize("lag", [0.0, 0.1, 1.0, 10.0])
def test_nobody_is_pulled_forward_or_back(lag):
    ratios = random_ratios(seed=3, birds=5, members=10, spread=0.005)
    ratios[:, 0] = 1.0
    for column in ratios.T:
        spacing, speed = delayed_all_to_all(flock_of(5, column[:, np.newaxis]), lag)
        with mpmath.workdps(30):
            column = [mp.mpf(ratio) for ratio in column.tolist()]
            x = [mp.mpf(value) for value in positions_of(spacing)]
            lateral = across(column)
            for j in range(5):
                force = surplus(column[j], speed)
                for i in set(range(5)) - {j}:
                    seen, y = x[i] - speed * lag - x[j], lateral[i] - lateral[j]
                    force -= drag(seen, y, column[i], column[j], (speed, speed), of=mp)
                # Found to 1e-14 a bird, and rounded to as much again.
                assert abs(force) < 2e-13


@pytest.mark.parametrize("birds", [2, 3, 6, 13])
@pytest.mark.parametrize("lag", [0.2, 2.0])
def test_newton_finds_the_chain_of_nearest_neighbours(birds, lag):
    ratios = random_ratios(seed=birds, birds=birds, members=10, spread=0.003)
    chain = delayed_nearest(flock_of(birds, ratios, "nearest"), lag)
    found = 0
    for member in np.flatnonzero(chain.margin > 0.01):
        flock = flock_of(birds, ratios[:, [member]], "nearest")
        if equilibrium(flock).exists[0]:
            spacing, speed = delayed_all_to_all(flock, lag)
            found += 1
            assert speed == pytest.approx(chain.speed[member], abs=1e-12)
            # Forces of 1e-14 a bird move gaps, that carry shares of 0.01 or more, by 1e3 of that.
            np.testing.assert_allclose(spacing, chain.spacing[:, member], rtol=0, atol=1e-10)
    assert found > 3


def test_equals_that_see_each_other_very_late_fly_abreast():
    # All wakes are as faint, 1 / d^2, whoever is beside whom: g / d goes to 0.
    spacing, speed = delayed_all_to_all(flock_of(5), 1000.0)
    assert np.all(np.abs(spacing) < 0.01)
    assert speed == pytest.approx(18.5 / 18.0, abs=1e-5)


def test_without_a_state_there_are_no_numbers():
    spacing, speed = delayed_all_to_all(flock_of(3, np.array([[0.6], [1.0], [1.0]])), 1.0)
    assert np.isnan(spacing).all()
    assert np.isnan(speed)


def test_stability_is_lost_as_with_nearest_neighbours():
    flock = flock_of(3)
    assert all(growth(flock, lag, "hold") < 0.0 for lag in np.geomspace(0.03, 30.0, 7))
    (found,) = crossings(flock, np.linspace(0.0, 100.0, 6), "linear")
    assert found.lost
