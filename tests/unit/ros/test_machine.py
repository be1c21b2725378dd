# SPDX-License-Identifier: Apache-2.0
"""The machine of a process that uses ROS 2."""

import os
from dataclasses import replace

import pytest

from flock_sim.recording.machine import this_machine
from flock_sim.ros.machine import machine_with_ros


def test_a_machine_with_ros_has_its_distribution_and_middleware(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delenv("ROS_DISTRO", raising=False)
    here = machine_with_ros()
    assert here.ros_distribution in ("jazzy", "kilted")
    assert here.rmw is not None
    assert here.rmw.startswith("rmw_")
    assert os.sep not in here.rmw
    assert replace(here, ros_distribution=None, rmw=None) == this_machine()
    monkeypatch.setenv("ROS_DISTRO", "rolling")
    assert machine_with_ros().ros_distribution == "rolling"
