# SPDX-License-Identifier: Apache-2.0
"""The machine of a process that uses ROS 2."""

from __future__ import annotations

import os
from importlib.metadata import PackageNotFoundError, version

import rclpy

from flock_sim.recording.machine import Machine, this_machine

DISTRIBUTIONS = {"7": "jazzy", "9": "kilted"}
"""ROS distributions by the first number of rclpy's version."""


def machine_with_ros() -> Machine:
    """Return the machine of this process, with its ROS distribution and middleware."""
    return this_machine(_distribution(), rclpy.get_rmw_implementation_identifier())


def _distribution() -> str | None:
    """Return the sourced ROS distribution; without a sourced one, that of rclpy."""
    if sourced := os.environ.get("ROS_DISTRO"):
        return sourced
    try:
        return DISTRIBUTIONS.get(version("rclpy").partition(".")[0])
    except PackageNotFoundError:
        return None
