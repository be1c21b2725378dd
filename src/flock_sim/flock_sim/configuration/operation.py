# SPDX-License-Identifier: Apache-2.0
"""Parameters of the operation of a node, as opposed to the configuration of the flight."""

from __future__ import annotations

import operator
from collections.abc import Mapping
from typing import Any

from flock_sim.configuration.choices import EXECUTORS
from flock_sim.configuration.flock_configuration import MEANING
from flock_sim.console.arguments import positive_number, shown, whole_number
from flock_sim.errors import FlockError, nearest

OPERATION: dict[str, Any] = {
    "index": 0,
    "indices": [],
    "run_id": 0,
    "window": 64,
    "record": True,
    "record_stages": False,
    "output": "",
    "force": False,
    "resume": False,
    "played": False,
    "executor": "events",
    "timeout": 600.0,
    "real_time_factor": 0.0,
}
"""The defaults."""

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
    "real_time_factor": "how much faster than real time birds fly freely; 0: in lockstep",
}
"""The meaning of each parameter of the operation of a node."""

OF_ROS = ("use_sim_time", "start_type_description_service", "qos_overrides")
"""Parameters of every ROS 2 node, which Flock does not use."""

QOS = "qos_overrides."
OURS = (f"{QOS}/flock/", f"{QOS}/clock.publisher.", f"{QOS}/diagnostics.publisher.")
"""Prefixes of overrides of the quality of service that concern Flock's topics."""


def parted(given: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Split the parameters `given` into those of the configuration and those of the operation.

    Raises FlockError on an unknown parameter, and on one that no node of Flock can apply.
    """
    flown, operation = {}, {}
    for key, value in given.items():
        if key in OPERATION:
            operation[key] = _like(key, value, OPERATION[key])
        elif key in MEANING:
            flown[key] = value
        elif key.startswith(OURS):
            raise FlockError(
                f"parameter {key!r}: nodes of a flock need the quality of service that they have, "
                "or messages would be lost; leave it out"
            )
        elif key.partition(".")[0] not in OF_ROS:
            raise FlockError(f"unknown parameter {key!r}: {nearest(key, [*MEANING, *OPERATION])}")
    check(operation)
    return flown, operation


def check(operation: Mapping[str, Any]) -> None:
    """Raise FlockError if a parameter of the operation of a node is out of range."""
    if "timeout" in operation:
        positive_number("timeout", str(operation["timeout"]))
    if "window" in operation:
        whole_number("window", str(operation["window"]), 1)
    if "run_id" in operation:
        whole_number("run_id", str(operation["run_id"]), 0, 2**63 - 1)
    if operation.get("real_time_factor"):
        positive_number("real_time_factor", str(operation["real_time_factor"]))
    executor = operation.get("executor", EXECUTORS[0])
    if executor not in EXECUTORS:
        raise FlockError(f"executor {executor!r}: {nearest(executor, EXECUTORS)}")


def _like(key: str, value: Any, default: Any) -> Any:
    """Return `value` if it has the type of `default`; a whole number may replace a real one."""
    if isinstance(default, list):
        try:
            return [operator.index(item) for item in value]
        except TypeError:
            raise FlockError(f"{key} = {value!r}: must be a list such as [1, 2]") from None
    if isinstance(default, float) and isinstance(value, int) and not isinstance(value, bool):
        value = _real(key, value)
    if type(value) is not type(default):
        raise FlockError(
            f"{key} = {value!r}: must be a {type(default).__name__} such as {default!r}"
        )
    return value


def _real(key: str, value: int) -> float:
    try:
        return float(value)
    except OverflowError:
        raise FlockError(
            f"{key} = {shown(str(value))}: must be a number that a float holds"
        ) from None
