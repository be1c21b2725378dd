# SPDX-License-Identifier: Apache-2.0
"""The process of the recorder: it owns the output, creates the node and records a flight."""

from __future__ import annotations

import sys
from contextlib import ExitStack
from pathlib import Path

from flock_sim.bag.writing.partial_bag import recorded_in
from flock_sim.configuration.operation import declared_by
from flock_sim.console.arguments import note
from flock_sim.errors import FlockError, RunFailed
from flock_sim.messages import topics
from flock_sim.nodes.played_recorder import check_played, record_played
from flock_sim.nodes.recorder import RecorderNode, record
from flock_sim.protocol.free_flight import GONE, check_free
from flock_sim.recording.flight_writer import recording
from flock_sim.recording.output_directory import own_bag, own_output
from flock_sim.ros.machine import machine_with_ros
from flock_sim.ros.parameters.declared import declare
from flock_sim.ros.process import Process, executing, run_node


def work(process: Process) -> None:
    """Record one flight."""
    configuration, operation = process.configuration, process.operation
    stages, factor = operation["record_stages"], operation["real_time_factor"]
    if factor:
        check_free(configuration, factor, operation["timeout"], stages)
    topics.steps_ahead(configuration, stages)  # refuses what can't be recorded
    if not operation["output"]:
        raise FlockError("output is not given: name a directory, as in -p output:=runs/mine")
    output = Path(operation["output"])
    if operation["played"]:
        check_played(operation)
    with ExitStack() as owned:
        resume, replace = _own(process, output, owned)
        if operation["played"]:
            record_played(process, output, replace)
            return
        run = owned.enter_context(
            recording(
                output,
                configuration,
                grants=True,
                stages=stages,
                resume=resume,
                replace=replace,
                factor=factor,
                machines=[machine_with_ros()],
            )
        )
        executor = owned.enter_context(executing(operation["executor"], process.context))
        if run.bag.aside is not None:
            kept = run.bag.aside.name
            note(f"{run.bag.path} is damaged or lacks steps, and is kept as {kept}")
        if factor and run.saved >= 0:
            raise FlockError(f"output {output}: {GONE}; name another output, or give force:=true")
        node = RecorderNode(
            configuration,
            run,
            operation["run_id"],
            stages,
            factor=factor,
            context=process.context,
        )
        declare(node, configuration, operation, declared_by("recorder"))
        executor.add_node(node)
        process.settle()
        record(node, executor, process.stop, process.watchdog(node))


def _own(process: Process, output: Path, owned: ExitStack) -> tuple[bool, bool]:
    """Own the output; return whether to continue the existing bag, and whether to replace it.

    Under `fly`, the process of `fly` owns the output and has begun the bag. Raises FlockError if
    the output can't be used, and RunFailed if the bag that `fly` has begun is gone.
    """
    operation = process.operation
    if process.supervised and operation["resume"]:
        if not output.is_dir() or recorded_in(output) is None:
            raise RunFailed(f"recording to {output} failed: it was removed or moved")
        return True, False
    if operation["resume"] and output.is_dir():
        owned.enter_context(own_bag(output))
        return True, False
    if output.exists() and not operation["force"]:
        raise FlockError(
            f"output {output} exists: continue it with -p resume:=true, replace it with "
            "-p force:=true, or name another output"
        )
    return False, owned.enter_context(own_output(output, operation["force"])).replaces


_main = run_node(
    "recorder",
    "Run the recorder of a flock as a ROS 2 node. It writes a rosbag2 bag (MCAP) of one flight,\n"
    "and ends with the flight. With played:=true and the configuration of the played flight, it\n"
    "records what ./flock play publishes, in a bag as ./flock reference writes it.",
    "  ./flock recorder --ros-args -p output:=runs/mine --params-file flock.yaml\n"
    "  ./flock recorder --ros-args -p output:=runs/mine -p resume:=true --params-file flock.yaml\n"
    "  ./flock recorder --ros-args -p output:=runs/again -p played:=true --params-file flock.yaml",
    work,
)


def main() -> int:
    """Run the `recorder` executable."""
    return _main(None)


if __name__ == "__main__":
    sys.exit(main())
