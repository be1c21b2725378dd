# SPDX-License-Identifier: Apache-2.0
"""Parameters of the operation of a node, as opposed to the configuration of the flight."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from flock_sim.configuration.choices import EXECUTORS
from flock_sim.configuration.parameter import Parameter
from flock_sim.errors import FlockError, nearest

BIRD, CLOCK, RECORDER = ("bird",), ("clock",), ("recorder",)
ALL = BIRD + CLOCK + RECORDER

OPERATION = {
    "index": Parameter(
        0, "number of this bird, from 1, the tail of the left wing", up_to_birds=True, nodes=BIRD
    ),
    "indices": Parameter([], "numbers of the birds of a process"),
    "run_id": Parameter(
        0, "number of the run; 0: the number that the clock has", least=0, most=2**63 - 1, nodes=ALL
    ),
    "window": Parameter(64, "steps that the clock grants in advance; 1: lockstep", nodes=CLOCK),
    "clock_every": Parameter(
        0, "steps between two messages of /clock; 0: only recorded steps", least=0, nodes=CLOCK
    ),
    "record": Parameter(True, "whether the clock waits for a recorder", nodes=CLOCK),
    "record_stages": Parameter(
        False, "whether Runge-Kutta stages are recorded too", nodes=CLOCK + RECORDER
    ),
    "output": Parameter("", "directory of the bag", nodes=RECORDER),
    "force": Parameter(False, "whether an existing bag is replaced", nodes=RECORDER),
    "resume": Parameter(False, "whether an existing bag is continued", nodes=RECORDER),
    "played": Parameter(False, "whether the recorded flight is one that ./flock play publishes"),
    "executor": Parameter(
        EXECUTORS[0], "executor of rclpy that serves the node", choices=EXECUTORS, nodes=ALL
    ),
    "timeout": Parameter(600.0, "longest time without progress, in s", nodes=ALL),
    "real_time_factor": Parameter(
        0.0, "speed of a free flight: simulated over real time; 0: lockstep", least=0, nodes=ALL
    ),
}
"""The parameters by name."""

DEFAULTS = {name: parameter.default for name, parameter in OPERATION.items()}

OF_ROS = ("use_sim_time", "start_type_description_service", "qos_overrides")
"""Parameters of every ROS 2 node, which Flock does not use."""

OURS = re.compile(
    r"qos_overrides\.(/(\w+/)*(bird_\d+/\w+|clock/grant|progress|checkpoint|perturbation)\.|"
    r"/flock/|/(clock|diagnostics)\.publisher\.)"
)
"""Beginning of overrides of the quality of service that concern Flock's topics."""


def declared_by(node: str) -> tuple[str, ...]:
    """Return the names of the parameters that `node` declares: `bird`, `clock` or `recorder`."""
    return tuple(name for name, parameter in OPERATION.items() if node in parameter.nodes)


def parted(given: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Split the parameters `given` into those of the configuration and those of the operation.

    Raises FlockError on a value of a wrong type or out of range, on an unknown parameter, and on
    one that no node of Flock can apply.
    """
    # Imported here, since --help needs no numpy.
    from flock_sim.configuration.flock_configuration import KEYS

    flown, operation = {}, {}
    for key, value in given.items():
        if key in OPERATION:
            operation[key] = OPERATION[key].typed(key, value)
        elif key in KEYS:
            flown[key] = value
        elif OURS.match(key):
            raise FlockError(
                f"parameter {key!r}: the quality of service of Flock's topics must not change, "
                "since messages would be lost; leave it out"
            )
        elif key.partition(".")[0] not in OF_ROS:
            raise FlockError(f"unknown parameter {key!r}: {nearest(key, [*KEYS, *OPERATION])}")
    for key, value in operation.items():
        OPERATION[key].checked(key, value)
    return flown, operation
