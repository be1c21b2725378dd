# SPDX-License-Identifier: Apache-2.0
"""What a node was given, declared so that `ros2 param list`, `get` and `describe` tell it.

All are read-only: a flight is what it was begun as.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.node import Node

from flock_sim.core.configuration import COUPLINGS, MEANING, MOST_BIRDS, FlockConfiguration
from flock_sim.nodes import EXECUTORS

OPERATION_MEANING = {
    "index": "number of this bird, from 1, the tail of the left wing",
    "run_id": "number of the run; 0: that of the clock",
    "window": "steps that birds may be granted ahead; 1 is lockstep",
    "record": "whether the clock waits for a recorder",
    "record_stages": "whether Runge-Kutta stages are recorded too",
    "output": "directory of the bag",
    "force": "whether a bag that is there is replaced",
    "resume": "whether a bag that is there is gone on with",
    "played": "whether a flight is recorded that is played, and not flown",
    "executor": "which executor of rclpy serves the node",
    "timeout": "how long to wait without news, in s",
    "stopwatch": "file that a process of birds writes where its time went to; empty: none",
    "real_time_factor": "how much faster than real time birds fly freely; 0: in lockstep",
}
"""What a node process can be told of how it operates."""

OF_ALL = ("run_id", "timeout", "executor", "real_time_factor")
"""What every node is told of that."""

CHOICES = {"coupling": COUPLINGS, "executor": EXECUTORS}

LEAST = {"birds": 1, "index": 1, "record_every": 1, "window": 1, "run_id": 0}
MOST = {"birds": MOST_BIRDS, "record_every": 2**53}
LARGEST = 2**63 - 1


def declare(
    node: Node, configuration: FlockConfiguration, operation: Mapping[str, Any], own: Sequence[str]
) -> None:
    """Declare the configuration, and of `operation` the parameters named in `own`, on `node`."""
    values = configuration.parameters() | {name: operation[name] for name in own}
    for name, value in values.items():
        # rclpy takes an empty list for one of bytes; an empty entry says as little.
        node.declare_parameter(
            name, [""] if value == [] else value, descriptor(name, value), ignore_override=True
        )


def descriptor(name: str, value: object) -> ParameterDescriptor:
    """Return what is told of parameter `name`: what it means and may be."""
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
