# SPDX-License-Identifier: Apache-2.0
"""The tableau is of fourth order, and the function applies the tableau."""

from fractions import Fraction
from math import exp

import numpy as np
import pytest

from flock_sim.physics.dynamics import stage_value
from flock_sim.physics.runge_kutta import STAGES, TABLEAU

WEIGHTS = TABLEAU[STAGES]
MATRIX = TABLEAU[:STAGES]
NODES = MATRIX.sum(axis=1)

# Butcher's conditions: one for every rooted tree of up to four vertices.
CONDITIONS = {
    "order 1": (WEIGHTS.sum(), 1.0),
    "order 2": (WEIGHTS @ NODES, 1.0 / 2.0),
    "order 3, bushy": (WEIGHTS @ NODES**2, 1.0 / 3.0),
    "order 3, tall": (WEIGHTS @ MATRIX @ NODES, 1.0 / 6.0),
    "order 4, bushy": (WEIGHTS @ NODES**3, 1.0 / 4.0),
    "order 4, mixed": (WEIGHTS @ (NODES * (MATRIX @ NODES)), 1.0 / 8.0),
    "order 4, fork": (WEIGHTS @ MATRIX @ NODES**2, 1.0 / 12.0),
    "order 4, tall": (WEIGHTS @ MATRIX @ MATRIX @ NODES, 1.0 / 24.0),
}


@pytest.mark.parametrize(("left", "right"), CONDITIONS.values(), ids=CONDITIONS)
def test_tableau_meets_every_order_condition_up_to_four(left, right):
    # 1/6 and 1/3 are rounded, and there are at most four terms below 1/3: four half ulps of it.
    assert left == pytest.approx(right, abs=4 * 2.0**-54)


def test_tableau_is_not_of_fifth_order():
    assert abs(WEIGHTS @ NODES**4 - 1.0 / 5.0) > 1e-3


def test_stages_use_earlier_stages_only():
    np.testing.assert_array_equal(np.triu(MATRIX), 0.0)
    assert TABLEAU.shape == (STAGES + 1, STAGES)


@pytest.mark.parametrize("quantity", [0, 1])
def test_a_step_of_a_linear_equation_is_the_exponentials_series_to_fourth_order(quantity):
    # y' = y over dt = 1/2: the step gives 1 + z + z^2/2 + z^3/6 + z^4/24 exactly.
    slopes = np.full((STAGES, 2), np.nan)
    value = 1.0
    for row in range(STAGES):
        slopes[row, quantity] = stage_value(1.0, 0.5, slopes, row, quantity)
    value = stage_value(1.0, 0.5, slopes, STAGES, quantity)
    z = Fraction(1, 2)
    series = 1 + z + z**2 / 2 + z**3 / 6 + z**4 / 24
    assert value == pytest.approx(float(series), rel=4 * 2.0**-53)
    # What is left out begins with z^5/120.
    assert 0.0 < exp(0.5) - value < 1.2 * 0.5**5 / 120


def test_the_first_stage_is_the_start_itself():
    assert stage_value(0.1, 1.0, np.full((STAGES, 1), np.nan), 0, 0) == 0.1


def test_a_cubic_in_time_is_integrated_exactly():
    # dy/dt = 4 t^3 depends on time alone: Simpson's rule, exact for cubics; y(1) = 1.
    slopes = np.array([[4.0 * node**3] for node in NODES])
    assert stage_value(0.0, 1.0, slopes, STAGES, 0) == pytest.approx(1.0, abs=4 * 2.0**-53)
