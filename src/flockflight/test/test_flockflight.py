# SPDX-License-Identifier: Apache-2.0
"""A smoke test for `colcon test`: the steady state of a pair against its closed form."""

from math import log, pi, sqrt

import pytest

import flockflight as ff


def test_a_pair_flies_abreast_at_the_speed_of_its_force_balance() -> None:
    steady = ff.Flock(2).equilibrium()
    assert bool(steady.exists)
    # The sum of both balances: U^2 + (1 + 2 e_O E / pi^2) U^-2 = U_0^2 + U_0^-2.
    induced = 1 + 2 * 0.8 / pi**2 * log(1 - (pi / 2) ** 2 / (1 + pi / 4) ** 2)
    thrust = (18.5 / 18.0) ** 2 + (18.0 / 18.5) ** 2
    speed = sqrt((thrust + sqrt(thrust**2 - 4 * induced)) / 2)
    assert float(steady.speed) == pytest.approx(speed, rel=1e-12)
    assert steady.spacing.values == pytest.approx([0.0], abs=1e-9)
