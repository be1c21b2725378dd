# SPDX-License-Identifier: Apache-2.0
"""The tableau is of fourth order, and the kernel applies the tableau."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from flock_sim.physics.dynamics import acceleration, circulation_at
from flock_sim.physics.runge_kutta import STAGES, TABLEAU
from flock_sim.physics.stage_kernels import move

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


def test_each_stage_uses_the_slope_before_it_alone():
    # So `move` needs the slope of one stage, and the weighted sum of all.
    np.testing.assert_array_equal(np.tril(MATRIX, -2), 0.0)


def step_by_tableau(position, speed, dt, coefficients, drags):
    """Return the values at the end of a step of one bird, by the definition of the method."""
    slopes = np.zeros((STAGES, 2))
    for stage in range(STAGES):
        _, now = (position, speed) + dt * (MATRIX[stage] @ slopes)
        slopes[stage] = now, acceleration(now, drags[stage], *coefficients[:4])
    return (position, speed) + dt * (WEIGHTS @ slopes)


numbers = st.floats(0.5, 2.0)


@given(
    start=st.tuples(st.floats(-10.0, 10.0), numbers),
    dt=st.floats(0.1, 2.0),
    coefficients=st.tuples(st.floats(5.0, 9.0), *[st.floats(0.0, 0.5)] * 3),
    drags=st.tuples(*[st.floats(-0.5, 0.5)] * STAGES),
)
def test_the_kernel_takes_the_step_of_the_tableau(start, dt, coefficients, drags):
    position, speed = np.array([start[0]]), np.array([start[1]])
    rows = np.array([*coefficients, 0.0])[:, np.newaxis]
    sums, now = np.full((2, 1), np.nan), np.empty((2, 1))
    for stages in (1, 2, 3, 4):  # an interrupted step leaves nothing to the next one
        now[:] = [position, speed]
        for stage, drag in enumerate(drags[:stages]):
            move(stage, dt, rows, np.array([drag]), position, speed, *sums, *now)
    expected = step_by_tableau(*start, dt, coefficients, drags)
    # Some twenty roundings of terms below 2, and of the position.
    assert now[:, 0] == pytest.approx(expected, abs=20 * 2.0**-52 * max(1.0, abs(start[0])))


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_every_nan_has_the_same_bits(sign):
    # inf - inf gives a NaN whose sign depends on the processor, and a NaN keeps the sign it has.
    rows = np.array([1.0, 0.0, 0.0, 0.0, 0.0])[:, np.newaxis]
    now = np.array([[0.0], [1.0]])
    bad = np.copysign(np.array([np.nan]), sign)
    move(0, 1.0, rows, bad, np.zeros(1), np.ones(1), *np.empty((2, 1)), *now)
    assert now[1].view(np.int64) == np.array([np.nan]).view(np.int64)
    assert np.float64(circulation_at(bad[0], 1.0)).view(np.int64) == np.float64(np.nan).view(int)
