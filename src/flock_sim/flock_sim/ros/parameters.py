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

from flock_sim.configuration.choices import COUPLINGS, EXECUTORS
from flock_sim.configuration.flock_configuration import MEANING, MOST_BIRDS, FlockConfiguration
from flock_sim.configuration.operation import OPERATION_MEANING

OF_ALL = ("run_id", "timeout", "executor", "real_time_factor")
"""Operating parameters of every node."""

CHOICES = {"coupling": COUPLINGS, "executor": EXECUTORS}

LEAST = {"birds": 1, "index": 1, "record_every": 1, "window": 1, "run_id": 0}
MOST = {"birds": MOST_BIRDS, "record_every": 2**53}
LARGEST = 2**63 - 1


def declare(
    node: Node, configuration: FlockConfiguration, operation: Mapping[str, Any], own: Sequence[str]
) -> None:
    """Declare on `node` the configuration, and the parameters of `operation` named in `own`."""
    values = configuration.parameters() | {name: operation[name] for name in own}
    for name, value in values.items():
        # rclpy treats an empty list as one of bytes; a list with an empty entry means the same.
        node.declare_parameter(
            name, [""] if value == [] else value, descriptor(name, value), ignore_override=True
        )


def descriptor(name: str, value: object) -> ParameterDescriptor:
    """Return the description of parameter `name`: its meaning and its range."""
    told = ParameterDescriptor(
        description={**MEANING, **OPERATION_MEANING}[name],
        read_only=True,
        additional_constraints="given at start",
    )
    if name in CHOICES:
        told.additional_constraints = f"one of {', '.join(CHOICES[name])}"
    elif isinstance(value, float):
        least = "0 or more" if name == "real_time_factor" else "above 0"
        told.additional_constraints = f"finite and {least}"
        told.floating_point_range = [
            FloatingPointRange(from_value=0.0, to_value=sys.float_info.max)
        ]
    elif isinstance(value, int) and not isinstance(value, bool):
        told.integer_range = [
            IntegerRange(from_value=LEAST[name], to_value=MOST.get(name, LARGEST), step=1)
        ]
    return told
