# SPDX-License-Identifier: Apache-2.0
"""The process of the clock of a flight that is started by hand or by `ros2 launch`."""

from __future__ import annotations

import sys

from flock_sim.configuration.operation import declared_by
from flock_sim.messages import topics
from flock_sim.messages.epochs import first_epoch
from flock_sim.messages.handshake import run_id_of
from flock_sim.nodes.clock import ClockNode, keep_time
from flock_sim.protocol.clock import Timekeeper
from flock_sim.ros.parameters.declared import declare
from flock_sim.ros.process import Process, executing, run_node


def work(process: Process) -> None:
    """Run the clock of one run."""
    operation = process.operation
    keeper = Timekeeper(
        process.configuration,
        operation["run_id"] or run_id_of(process.configuration),
        operation["window"],
        operation["record"],
        operation["record_stages"],
        first_epoch(),
        factor=operation["real_time_factor"],
        clock_every=operation["clock_every"],
    )
    depth = topics.clock_depth(process.configuration, operation["clock_every"])
    with executing(operation["executor"], process.context) as executor:
        clock = ClockNode(keeper, depth, context=process.context)
        declare(clock, process.configuration, operation, declared_by("clock"))
        executor.add_node(clock)
        process.settle()
        keep_time(clock, executor, process.watchdog(clock), lambda: process.stop)
        clock.release(process.stop)
        clock.farewell(process.stop)


_main = run_node(
    "clock",
    "Run the clock of a flock as a ROS 2 node. It waits until all birds and the recorder are\n"
    "present, grants steps, publishes the simulated time, and ends with the flight. If it is\n"
    "killed and started again with the same parameters, the flight continues.\n"
    "Its services are ~/pause, ~/resume, ~/stop (std_srvs/Trigger), ~/step and ~/perturb\n"
    "(flock_interfaces/Step and Perturb).",
    "  ./flock clock --ros-args --params-file flock.yaml\n"
    "  ./flock clock --timeout 20 --ros-args -p birds:=3 -p record:=false\n"
    "  ros2 service call /flock/clock/pause std_srvs/srv/Trigger",
    work,
)


def main() -> int:
    """Run the `clock` executable."""
    return _main(None)


if __name__ == "__main__":
    sys.exit(main())
