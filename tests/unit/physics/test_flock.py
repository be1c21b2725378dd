# SPDX-License-Identifier: Apache-2.0
"""The constants of a whole flock against the paper's formulas."""

from math import pi

import numpy as np
import pytest

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.physics.flock import Flock
from support.steady_flocks import GAMMA, H_0, MASS, A, K, across, even, pairs, random_ratios

EPS = 2.0**-52


@pytest.mark.parametrize("coupling", ["nearest", "all"])
@pytest.mark.parametrize("birds", [1, 2, 5, 6])
def test_pairs_are_who_feels_whom(birds, coupling):
    flock = Flock.of(FlockConfiguration(birds=birds, coupling=coupling))
    assert [tuple(pair) for pair in flock.pairs] == pairs(birds, coupling)
    assert flock.pairs.shape == (len(pairs(birds, coupling)), 2)
    assert flock.lateral.shape == flock.even.shape == (len(flock.pairs), 1)


@pytest.mark.parametrize("coupling", ["nearest", "all"])
def test_distances_and_even_parts_are_those_of_the_paper(coupling):
    ratios = random_ratios(seed=1, birds=6, members=9, spread=0.1)
    flock = Flock.of(FlockConfiguration(birds=6, coupling=coupling), ratios)
    for member in range(9):
        column = [float(ratio) for ratio in ratios[:, member]]
        side = across(column)
        for k, (i, j) in enumerate(pairs(6, coupling)):
            # Five distances of up to 3 are added in two orders: two roundings a term.
            assert flock.lateral[k, member] == pytest.approx(side[j] - side[i], rel=10 * EPS)
            # Neighbours' E = ln(p s / q r) has s of some 0.2 from terms of 2: 10 times as much.
            expected = even(side[j] - side[i], A * column[i], A * column[j])
            assert flock.even[k, member] == pytest.approx(expected, abs=100 * EPS)


def test_constants_of_a_bird_scale_as_in_the_paper():
    flock = Flock.of(FlockConfiguration(birds=3, span_ratios=("1=0.9", "3=1.2")))
    for ratio, rows in zip((0.9, 1.0, 1.2), flock.coefficients[:, :, 0]):
        expected = [
            ratio**3 * MASS,
            ratio**4 * 2.0 * K * H_0,
            ratio**2 * K,
            ratio**4 * K,
            ratio**2 * GAMMA,
        ]
        np.testing.assert_allclose(rows, expected, rtol=10 * EPS)  # as many multiplications
        np.testing.assert_allclose(flock.half_span[:, 0], pi / 4.0 * np.array([0.9, 1.0, 1.2]))


def test_other_span_ratios_replace_those_of_the_configuration():
    configuration = FlockConfiguration(birds=4, span_ratios=("2=1.1,1.2",))
    assert Flock.of(configuration).members == 2
    flock = Flock.of(configuration, np.full((4, 7), 1.3))
    assert (flock.birds, flock.members) == (4, 7)
    assert np.all(flock.span_ratio == 1.3)
    assert flock.coefficients.shape == (4, 5, 7)


def test_a_bird_alone_feels_nobody():
    flock = Flock.of(FlockConfiguration(birds=1))
    assert flock.pairs.shape == (0, 2)
    assert flock.even.shape == (0, 1)
