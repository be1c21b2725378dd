# SPDX-License-Identifier: Apache-2.0
"""The libraries of ROS leave the arithmetic of a process as IEEE 754 has it by default.

A library that is compiled with -ffast-math can make a process flush small numbers to zero.
"""

from __future__ import annotations

import sys
from operator import add, mul

from rclpy.context import Context
from rclpy.node import Node

from flock_sim.ros.fastdds_shutdown import leave

LEAST = 5e-324


def test_small_numbers_are_kept_and_sums_are_rounded_to_nearest(context: Context) -> None:
    node = Node("arithmetic", context=context)
    try:
        assert mul(sys.float_info.min, 0.5) > 0.0
        assert mul(LEAST, 1.0) == LEAST
        # Half a unit of the last place is rounded to even, three quarters upwards.
        assert add(1.0, 0.5 * sys.float_info.epsilon) == 1.0
        assert add(1.0, 0.75 * sys.float_info.epsilon) == 1.0 + sys.float_info.epsilon
        assert add(-1.0, -0.5 * sys.float_info.epsilon) == -1.0
    finally:
        leave(context, [node])
