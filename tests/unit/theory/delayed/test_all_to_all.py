# SPDX-License-Identifier: Apache-2.0
"""The steady state of all-to-all coupling at a constant lag, against the chain and the forces."""

from functools import partial

import numpy as np
import pytest

from flock_sim.theory.delayed.all_to_all import delayed_all_to_all
from flock_sim.theory.delayed.nearest import delayed_nearest
from flock_sim.theory.delayed.stability import crossings, growth
from flock_sim.theory.equilibrium import equilibrium
from support.steady_flocks import random_ratios
from support.steady_states import flock_of, largest_force

all_coupled = partial(flock_of, coupling="all")


@pytest.mark.parametrize("lag", [0.0, 0.1, 1.0, 10.0])
def test_nobody_is_pulled_forward_or_back(lag):
    ratios = random_ratios(seed=3, birds=5, members=10, spread=0.005)
    ratios[:, 0] = 1.0
    for column in ratios.T:
        spacing, speed = delayed_all_to_all(all_coupled(5, column), lag)
        # Found to 1e-14 a bird, and rounded to as much again.
        assert largest_force(spacing, speed, column, "all", lag=lag) < 2e-13


@pytest.mark.parametrize("birds", [2, 3, 6, 13])
@pytest.mark.parametrize("lag", [0.2, 2.0])
def test_newton_finds_the_chain_of_nearest_neighbours(birds, lag):
    ratios = random_ratios(seed=birds, birds=birds, members=10, spread=0.003)
    chain = delayed_nearest(flock_of(birds, ratios), lag)
    found = 0
    for member in np.flatnonzero(chain.margin > 0.01):
        flock = flock_of(birds, ratios[:, [member]])
        if equilibrium(flock).exists[0]:
            spacing, speed = delayed_all_to_all(flock, lag)
            found += 1
            assert speed == pytest.approx(chain.speed[member], abs=1e-12)
            # Forces of 1e-14 a bird move gaps, that carry shares of 0.01 or more, by 1e3 of that.
            np.testing.assert_allclose(spacing, chain.spacing[:, member], rtol=0, atol=1e-10)
    assert found > 3


def test_equals_that_see_each_other_very_late_fly_abreast():
    # All wakes are as faint, 1 / d^2, whoever is beside whom: g / d goes to 0.
    spacing, speed = delayed_all_to_all(all_coupled(5), 1000.0)
    assert np.all(np.abs(spacing) < 0.01)
    assert speed == pytest.approx(18.5 / 18.0, abs=1e-5)


def test_without_a_state_there_are_no_numbers():
    spacing, speed = delayed_all_to_all(all_coupled(3, [0.6, 1.0, 1.0]), 1.0)
    assert np.isnan(spacing).all()
    assert np.isnan(speed)


def test_stability_is_lost_as_with_nearest_neighbours():
    flock = all_coupled(3)
    assert all(growth(flock, lag, "hold") < 0.0 for lag in np.geomspace(0.03, 30.0, 7))
    (found,) = crossings(flock, np.linspace(0.0, 100.0, 6), "linear")
    assert found.lost
