# SPDX-License-Identifier: Apache-2.0
"""Places and speeds in the world are those of the flight, by REP 103 and in SI units."""

from __future__ import annotations

import numpy as np
import pytest

from flock_sim.physics import formation
from flock_sim.physics.flock_state import FlockState
from unit.scene.test_shapes import RATIO, snapshot


def state() -> FlockState:
    return snapshot().state


def test_x_is_forward_y_to_the_left_and_z_up() -> None:
    shown = snapshot()
    x, y, z = shown.world.T
    assert x == pytest.approx(0.8 * state().position)  # b = 0.8 m
    lateral = formation.lateral_positions(RATIO[:, np.newaxis])[:, 0]
    assert y == pytest.approx(-0.8 * lateral)
    assert y[0] > y[1] > 0.0 > y[3] > y[4]  # bird 1 flies at the end of the left wing
    assert (y[2], np.signbit(y[2])) == (0.0, False)  # the leader
    assert (z == 0.0).all()
    assert not np.signbit(z).any()


def test_speeds_are_in_metres_per_second() -> None:
    shown = snapshot()
    assert shown.configuration.min_drag_speed == 17.0
    assert shown.world_speed == pytest.approx(17.0 * 1.2)


def test_a_move_is_the_speed_times_the_time_in_si_units() -> None:
    before = snapshot()
    after = snapshot(position=state().position + state().speed * 5.0)  # 5 b/U_min later
    moved = after.world[:, 0] - before.world[:, 0]
    assert moved == pytest.approx(before.world_speed * 5.0 * before.configuration.second)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("name", "huge"), [("position", np.inf), ("speed", np.inf), ("speed", 1e308)]
)
def test_a_bird_that_has_diverged_is_left_out(name: str, huge: float) -> None:
    values = getattr(state(), name).copy()
    values[0], values[3] = np.nan, huge
    assert snapshot().finite_birds == [1, 2, 3, 4, 5]
    assert snapshot(**{name: values}).finite_birds == [2, 3, 5]
