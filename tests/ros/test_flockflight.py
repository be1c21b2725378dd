# SPDX-License-Identifier: Apache-2.0
"""A flight from Python over ROS 2 is the run without ROS, bit for bit."""

from pathlib import Path

import pytest
import xarray as xr

import flockflight as ff

pytestmark = pytest.mark.ros


def test_a_flight_over_ros_is_the_run(tmp_path: Path) -> None:
    flock = ff.Flock(
        3,
        spans={2: [1.0, 0.98]},
        links=ff.Link("hold", interval=3),
        forcing=ff.Force("gust", std=1e-5, seed=3),
        pushes=ff.Push(1, step=40, speed=0.01),
        t_max=100,
        record_every=5,
    )
    flown = flock.fly(tmp_path / "flown")
    xr.testing.assert_equal(flown, flock.run(tmp_path / "run"))
    assert ff.compare(tmp_path / "flown", tmp_path / "run").equal
