# SPDX-License-Identifier: Apache-2.0
"""One flight, every bird a process of its own.

ros2 launch flock_sim flock.launch.py birds:=7 config:=flock.yaml output:=runs/seven
"""

from launch import LaunchContext, LaunchDescription
from launch.actions import OpaqueFunction
from launch_ros.actions import Node

from flock_sim.launcher.ros2_launch_arguments import ARGUMENTS
from flock_sim.launcher.ros2_launch_nodes import Flight, declare


def generate_launch_description() -> LaunchDescription:
    """Return the arguments, and the action that starts the flight."""
    return LaunchDescription([*declare(ARGUMENTS), OpaqueFunction(function=fly)])


def fly(context: LaunchContext) -> list[Node]:
    """Return the nodes of the flight."""
    flight = Flight(context, ARGUMENTS)
    birds = [flight.birds([index]) for index in range(1, flight.arguments.configuration.birds + 1)]
    return [flight.clock(), *flight.recorder(), *birds]
