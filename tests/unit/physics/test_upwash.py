# SPDX-License-Identifier: Apache-2.0
"""The interaction integral is the integral of the velocity field."""

from __future__ import annotations

from math import pi

import numpy as np
import pytest

from flock_sim.physics.aerodynamics import interaction_integral
from flock_sim.physics.upwash import flock_upwash, upwash

NODES, WEIGHTS = np.polynomial.legendre.leggauss(200)


@pytest.mark.parametrize("behind", [-3.0, -0.2, 0.0, 0.4, 5.0])
@pytest.mark.parametrize(("half", "other_half"), [(0.8, 0.8), (0.7, 0.9)])
@pytest.mark.parametrize("across", [1.9, -2.5])
def test_along_a_bound_vortex_it_integrates_to_the_interaction_integral(
    behind: float, half: float, other_half: float, across: float
) -> None:
    points = across + other_half * NODES
    velocity = upwash(behind, points, 0.0, half, 2.0)
    # D = -rho Gamma' int w dy = rho Gamma Gamma' I / (4 pi): Eq. (D12)
    integral = -4.0 * pi / 2.0 * other_half * (WEIGHTS @ velocity)
    expected = interaction_integral(behind, across, half, other_half)
    assert integral == pytest.approx(float(expected), rel=1e-9)


def test_far_behind_it_is_that_of_two_lines() -> None:
    across = np.array([-2.0, -0.5, 0.0, 0.3, 1.5])
    above = 0.4
    a, circulation = 0.8, 0.1

    def line(y: np.ndarray) -> np.ndarray:
        return circulation / (2.0 * pi) * y / (y**2 + above**2)

    expected = line(across - a) - line(across + a)
    assert upwash(1e7, across, above, a, circulation) == pytest.approx(expected, rel=1e-9)
    middle = upwash(1e7, 0.0, 0.0, a, circulation)
    assert float(middle) == pytest.approx(-circulation / (pi * a), rel=1e-9)
    assert float(upwash(-1e7, 0.1, 0.2, a, circulation)) == pytest.approx(0.0, abs=1e-9)


def test_behind_a_bird_the_air_goes_down_between_the_tips_and_up_outside_of_them() -> None:
    a = 0.785
    behind = np.array([0.01, 0.5, 3.0, 100.0])[:, np.newaxis]
    assert (upwash(behind, np.linspace(-0.99, 0.99, 21) * a, 0.0, a, 0.1) < 0.0).all()
    assert (upwash(behind, np.array([-4.0, -1.01, 1.01, 4.0]) * a, 0.0, a, 0.1) > 0.0).all()


def test_fields_of_birds_add_up() -> None:
    point = np.random.default_rng(1).normal(size=(4, 5, 3))
    position, lateral = np.array([0.0, -1.8]), np.array([0.0, 1.785])
    half, circulation = np.array([0.785, 0.7]), np.array([0.1, 0.09])
    both = flock_upwash(point, position, lateral, half, circulation)
    each = [
        flock_upwash(
            point, *(values[k : k + 1] for values in (position, lateral, half, circulation))
        )
        for k in range(2)
    ]
    assert both == pytest.approx(each[0] + each[1], rel=1e-12)
    assert both.shape == (4, 5)
    place = np.array([-3.0, 2.0, 0.5])
    alone = upwash(3.0, 2.0, 0.5, 0.785, 0.1) + upwash(1.2, 0.215, 0.5, 0.7, 0.09)
    assert float(flock_upwash(place, position, lateral, half, circulation)) == pytest.approx(
        float(alone), rel=1e-12
    )
