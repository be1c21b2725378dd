# SPDX-License-Identifier: Apache-2.0
"""The interaction of two birds without a compiler equals that of the kernels bit for bit."""

from __future__ import annotations

import struct
from itertools import product
from math import inf, nan

import numpy as np
import pytest

from flock_sim.physics import aerodynamics, interaction

DISTANCES = [0.0, 5e-324, 1e-9, 0.1, 1.7, 40.0, 1e8, 1e77, 1e110, 1e160, 1e308, inf, nan]
WINGS = [(np.pi / 4.0, np.pi / 4.0), (0.3, 1.1), (1e-3, 0.7)]
GAPS = [1e-12, 1e-3, 0.2146, 5.0]


def bits(*values: float) -> list[bytes]:
    return [struct.pack("<d", abs(value) if value != value else value) for value in values]


@pytest.mark.parametrize(("source", "target"), WINGS)
def test_both_give_the_same_bits(source: float, target: float) -> None:
    for gap, distance in product(GAPS, DISTANCES):
        lateral = source + target + gap
        even = interaction.even_part(lateral, source, target)
        assert bits(even) == bits(aerodynamics.even_part(lateral, source, target))
        plain = interaction.ahead_integral_and_slope(distance, lateral, source, target)
        compiled = aerodynamics.ahead_integral_and_slope(distance, lateral, source, target)
        assert bits(*plain) == bits(*compiled), (distance, lateral)
        for x in (-distance, distance):
            both = interaction.split_drag(x, 0.1, plain[0], even)
            assert bits(*both) == bits(*aerodynamics.split_drag(x, 0.1, plain[0], even))


def test_both_give_the_same_bits_wherever_birds_fly() -> None:
    random = np.random.default_rng(7)
    for _ in range(2000):
        source, target = random.uniform(0.3, 1.5, 2).tolist()
        lateral = source + target + random.uniform(1e-3, 2.0)
        distance = float(random.exponential(5.0))
        plain = interaction.ahead_integral_and_slope(distance, lateral, source, target)
        compiled = aerodynamics.ahead_integral_and_slope(distance, lateral, source, target)
        assert bits(*plain) == bits(*compiled)
