# SPDX-License-Identifier: Apache-2.0
"""One flight, its birds composed in a few processes: much faster than a process a bird.

ros2 launch flock_sim composed.launch.py birds:=101 processes:=2
"""

from launch import LaunchContext, LaunchDescription
from launch.actions import OpaqueFunction
from launch_ros.actions import Node

from flock_sim.launcher.ros2_launch_arguments import ARGUMENTS, PROCESSES
from flock_sim.launcher.ros2_launch_nodes import Flight, declare

KNOWN = ARGUMENTS | PROCESSES


def generate_launch_description() -> LaunchDescription:
    """Return the arguments, and the action that starts the flight."""
    return LaunchDescription([*declare(KNOWN), OpaqueFunction(function=fly)])


def fly(context: LaunchContext) -> list[Node]:
    """Return the nodes of the flight."""
    flight = Flight(context, KNOWN)
    birds = [flight.birds(share) for share in flight.arguments.partition()]
    return [flight.clock(), *flight.recorder(), *birds]
