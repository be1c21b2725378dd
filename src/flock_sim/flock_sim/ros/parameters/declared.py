# SPDX-License-Identifier: Apache-2.0
"""Parameters of a node, declared so that `ros2 param list`, `get` and `describe` show them.

All are read-only: a flight keeps the configuration with which it was begun.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.node import Node

from flock_sim.configuration.flock_configuration import KEYS, MEANING, FlockConfiguration
from flock_sim.configuration.operation import OPERATION

LARGEST = 2**63 - 1
"""The largest whole number that a parameter of ROS holds."""


def declare(
    node: Node, configuration: FlockConfiguration, operation: Mapping[str, Any], own: Sequence[str]
) -> None:
    """Declare on `node` the configuration, and the parameters of `operation` named in `own`."""
    values = configuration.parameters() | {name: operation[name] for name in own}
    for name, value in values.items():
        # rclpy treats an empty list as one of bytes; a list with an empty entry means the same.
        node.declare_parameter(
            name, [""] if value == [] else value, descriptor(name), ignore_override=True
        )


def descriptor(name: str) -> ParameterDescriptor:
    """Return the description of parameter `name`: its meaning and its range."""
    parameter = OPERATION.get(name) or KEYS[name]
    meaning = MEANING.get(name, parameter.meaning)
    told = ParameterDescriptor(
        description=meaning, read_only=True, additional_constraints="given at start"
    )
    if parameter.choices:
        told.additional_constraints = f"one of {', '.join(parameter.choices)}"
    elif isinstance(parameter.default, float):
        least = "above 0" if parameter.least else "0 or more"
        told.additional_constraints = f"finite and {least}"
        told.floating_point_range = [
            FloatingPointRange(from_value=0.0, to_value=sys.float_info.max)
        ]
    elif type(parameter.default) is int:
        most = LARGEST if parameter.most is None else parameter.most
        told.integer_range = [IntegerRange(from_value=parameter.least, to_value=most, step=1)]
    return told
