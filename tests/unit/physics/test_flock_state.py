# SPDX-License-Identifier: Apache-2.0
"""The state of a flock is that of its birds, and of each member alone."""

from __future__ import annotations

import numpy as np
import pytest

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.messages.state import ARRAYS
from flock_sim.messages.types import State
from flock_sim.physics.flock_state import FlockState
from flock_sim.physics.scaling import Scales

FLOCK = FlockConfiguration(birds=4, span_ratios=("1=0.9,1.0,1.1",))
VALUES = np.random.default_rng(3).normal(size=(6, 4, 3))  # quantities, birds, members


@pytest.fixture
def state() -> FlockState:
    return FlockState.of([State.at(FLOCK, 20, *VALUES[:, bird]) for bird in range(4)])


def test_birds_are_rows_and_members_are_columns(state: FlockState) -> None:
    assert (state.step, state.time) == (20, FLOCK.time(20))
    for name, values in zip(ARRAYS, VALUES, strict=True):
        assert np.array_equal(getattr(state, name), values)


def test_a_member_alone_has_the_same_values_to_the_bit(state: FlockState) -> None:
    scales = Scales.of(FLOCK)
    for m in range(3):
        alone = state.member(m)
        assert (alone.step, alone.time) == (state.step, state.time)
        for name in (*ARRAYS, "from_leader", "spacing", "finite"):
            assert np.array_equal(getattr(alone, name), getattr(state, name)[..., m])
        assert np.array_equal(alone.drag_reduction(scales), state.drag_reduction(scales)[:, m])
    assert (state.from_leader[2] == 0.0).all()
    assert np.array_equal(state.spacing, state.position[1:] - state.position[:-1])
    assert np.array_equal(state.drag_reduction(scales), -VALUES[3] / scales.cruise_drag)


@pytest.mark.parametrize("quantity", [0, 1])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_one_bird_that_diverges_makes_its_member_not_finite(quantity: int, value: float) -> None:
    values = VALUES.copy()
    values[quantity, 1, 2] = value
    assert FlockState(0, 0.0, *values).finite.tolist() == [True, True, False]
