# SPDX-License-Identifier: Apache-2.0
"""The composed launcher: a whole flock over ROS 2 with one command."""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

from flock_sim.commands.flight_report import add_output_options, claim_output, report
from flock_sim.commands.law_option import LAW_WITHOUT_BAG, add_law_option
from flock_sim.configuration.choices import EXECUTORS, MODES
from flock_sim.configuration.operation import OPERATION
from flock_sim.configuration.options import (
    add_flock_options,
    flock_configuration,
    flock_parameters,
    named,
)
from flock_sim.console.arguments import (
    TIMEOUT,
    Parser,
    note,
    positive_number,
    run_tool,
)
from flock_sim.console.signals import end_process
from flock_sim.errors import FlockError, nearest
from flock_sim.launcher.flight import WINDOW, Plan, begin_bag, fly, on_ros
from flock_sim.launcher.partition import partition, process_count
from flock_sim.ros.discovery import NETWORK_HELP
from flock_sim.ros.ros_arguments import namespace, split

if TYPE_CHECKING:
    from flock_sim.commands.resume import Resumable
    from flock_sim.ros.parameters.node_parameters import FlightParameters

DESCRIPTION = """\
Fly a flock over ROS 2, record it as a rosbag2 bag, and print its metrics. Each bird is a node,
which computes its own motion from the messages of its neighbours.
Lengths are in b (half the standard wing span), speeds in U_min (the speed of least drag of the
standard bird), times in b/U_min (0.042 s for the default bird, a Canada goose).
--ros-args at the end begins ROS arguments for all nodes, such as a namespace or a log level.
Exit status: 0 flown; 1 the flight failed; 2 bad input; 130 Ctrl-C, after which --resume continues
the flight."""

EXAMPLES = """\
  ./flock fly                                         thirteen geese to their steady state
  ./flock fly --birds 7 --t-max 1e5 --processes 2     seven birds in two processes
  ./flock fly --span-ratio 4=0.95,1.0,1.05            three flocks at once, bird 4 differs
  ./flock fly --config flock.yaml --output runs/mine --force
  ./flock fly --forcing gust:std=2e-5 --forcing my_laws.py:keeper:gap=0.8
  ./flock fly --resume runs/mine                      continues a flight that was cut short
  ./flock fly --mode free --t-max 500                 21 s in which no bird waits for another
  ./flock fly --ros-args -r __ns:=/left               topics /left/bird_01/state and so on"""


def tool(arguments: Sequence[str]) -> int:
    """Fly a flock over ROS 2, record it, and print its report."""
    options = _options(arguments)
    if not options.resume:
        if options.law:
            raise FlockError(LAW_WITHOUT_BAG)
        return _fly(options, _plan(options, None))
    from flock_sim.commands.resume import resumable

    with resumable(options.resume, options) as resumed:
        return _fly(options, _plan(options, resumed), resumed)


def _fly(options: argparse.Namespace, plan: Plan, resumed: Resumable | None = None) -> int:
    """Fly `plan`, and print its report."""
    if resumed and resumed.complete:
        note(f"{options.resume} is complete: there is nothing to continue")
        how = dict.fromkeys(("steps_per_second", "start_seconds", "wall_seconds"), 0.0)
        counts = dict.fromkeys(("steps_flown_again", "rewinds", "restarts"), 0)
        last = plan.configuration.steps
        flight = {**how, **counts, "output": str(options.resume), "last_step": last}
        report(flight, plan.configuration, options.json)
        return 0
    with ExitStack() as owned:
        output = resumed.output if resumed else None
        with on_ros(options.network):
            if resumed:
                _go_on(resumed.output.path, plan)
            elif _is_recorded(options, plan.told):
                output = owned.enter_context(claim_output(plan.output, options.force, "fly"))
                plan = replace(plan, output=output.path)
                begin_bag(output, plan)
                note(f"recording to {output.path}")
            flown = fly(plan)
        flight = {
            **flown,
            "wall_seconds": time.monotonic() - plan.begun,
            "output": None if output is None else str(output.path),
        }
        if output is not None:
            output.check()
        report(flight, plan.configuration, options.json)
    return 0


def _options(arguments: Sequence[str]) -> argparse.Namespace:
    own, ros_arguments = split(arguments)
    options = _parser().parse_args(own)
    options.ros_arguments = tuple(ros_arguments)
    return options


def _parser() -> Parser:
    parser = Parser("fly", DESCRIPTION, EXAMPLES)
    add_flock_options(parser)
    add_output_options(parser)
    parser.add_argument(
        "--resume",
        metavar="RUN",
        type=Path,
        help="continue a flight that was cut short, from the last step in its bag",
    )
    add_law_option(parser, "--resume")
    how = parser.add_argument_group(
        "execution", "these options do not change the values of the flight"
    )
    free = parser.add_argument_group(
        "free flight", "birds do not wait for messages, so no two flights are equal"
    )
    free.add_argument(
        "--mode",
        metavar="|".join(MODES),
        default=MODES[0],
        help="lockstep: birds wait for each other's messages; free: each bird has its own timer "
        f"({MODES[0]})",
    )
    free.add_argument(
        "--real-time-factor",
        metavar="F",
        help="speed of a free flight: simulated time over real time (1)",
    )
    how.add_argument(
        "--processes", metavar="P", default="1", help="number of processes that the birds share (1)"
    )
    how.add_argument(
        "--window",
        metavar="W",
        help=f"number of steps that the clock grants in advance; 1: no bird begins a step before "
        f"all birds have finished the last one ({WINDOW})",
    )
    how.add_argument(
        "--clock-every",
        metavar="K",
        help="steps between two messages of /clock; 0: only recorded steps (0)",
    )
    how.add_argument(
        "--executor", metavar="|".join(EXECUTORS), help=f"executor of rclpy ({EXECUTORS[0]})"
    )
    how.add_argument(
        "--timeout",
        metavar="S",
        help=f"time without progress after which the flight fails, in s ({TIMEOUT})",
    )
    how.add_argument(
        "--no-respawn",
        action="store_true",
        help="if a process is killed, end the flight instead of restarting the process",
    )
    how.add_argument("--network", action="store_true", help=NETWORK_HELP)
    how.add_argument(
        "--record-stages",
        action="store_true",
        help="also record the messages of the Runge-Kutta stages",
    )
    how.add_argument("--no-record", action="store_true", help="fly without a bag")
    return parser


def _plan(options: argparse.Namespace, resumed: Resumable | None) -> Plan:
    from flock_sim.messages import topics
    from flock_sim.protocol.free_flight import check_free
    from flock_sim.ros.parameters.node_parameters import CLOCK

    told = _told(options, resumed)
    configuration, clock = told.configuration, told.of([CLOCK])
    executor = _said(options.executor, clock.get("executor", EXECUTORS[0]))
    if executor not in EXECUTORS:
        raise FlockError(f"--executor {executor}: {nearest(executor, EXECUTORS)}")
    output, stages = _recorded(options, resumed, told)
    timeout = OPERATION["timeout"].checked(
        "--timeout", _said(options.timeout, clock.get("timeout", TIMEOUT))
    )
    factor = _factor(options, clock.get("real_time_factor", 0.0))
    if factor:
        check_free(configuration, factor, timeout, stages)
    topics.steps_ahead(configuration, stages)  # raises FlockError if it can't be recorded
    processes = process_count(
        "--processes", options.processes, configuration.birds, configuration.coupling
    )
    plan = Plan(
        configuration,
        output,
        processes,
        timeout,
        time.monotonic(),
        OPERATION["window"].checked("--window", _said(options.window, clock.get("window", WINDOW))),
        executor,
        stages,
        not options.no_respawn and not factor,
        resumed is not None,
        real_time_factor=factor,
        told=told,
        from_file=tuple(key for key in ("timeout", "executor") if getattr(options, key) is None),
        clock_every=OPERATION["clock_every"].checked(
            "--clock-every", _said(options.clock_every, clock.get("clock_every", 0))
        ),
        ros_arguments=options.ros_arguments,
    )
    topics.clock_depth(configuration, plan.clock_every)  # raises FlockError if it is too deep
    if options.config:
        with named(options.config):
            for birds in partition(configuration.birds, processes):
                plan.operation(map(topics.bird_name, birds))  # refuses what one process can't have
    return plan


def _told(options: argparse.Namespace, resumed: Resumable | None) -> FlightParameters:
    """Return the configuration, and the operation of the nodes from the configuration file."""
    from flock_sim.ros.parameters.node_parameters import FlightParameters, of_flight

    if resumed:
        return FlightParameters(resumed.configuration)
    if not options.config:
        return FlightParameters(flock_configuration(options))
    with named(options.config):
        parameters = flock_parameters(options)
        return of_flight(options.config, parameters, namespace(options.ros_arguments))


def _recorded(
    options: argparse.Namespace, resumed: Resumable | None, told: FlightParameters
) -> tuple[Path | None, bool]:
    """Return the output of a flight, and whether stages are recorded too.

    The output is None if the flight is not recorded, or if it goes to a new directory.
    """
    from flock_sim.messages.topics import RECORDER
    from flock_sim.ros.parameters.node_parameters import CLOCK

    if resumed:
        return options.resume, resumed.stages
    clock, recorder = told.of([CLOCK]), told.of([RECORDER])
    stages = any([options.record_stages, *(one.get("record_stages") for one in (clock, recorder))])
    if not _is_recorded(options, told):
        if stages:
            raise FlockError("--record-stages and --no-record exclude each other: leave one out")
        return None, False
    output = options.output or recorder.get("output")
    return (Path(output) if output else None), stages


def _is_recorded(options: argparse.Namespace, told: FlightParameters | None) -> bool:
    from flock_sim.ros.parameters.node_parameters import CLOCK

    return not options.no_record and (told is None or told.of([CLOCK]).get("record", True))


def _factor(options: argparse.Namespace, told: float) -> float:
    """Return the real-time factor, 0 in lockstep; `told` is that of the configuration file.

    Raises FlockError if another option excludes the mode.
    """
    if options.mode not in MODES:
        raise FlockError(f"--mode {options.mode}: {nearest(options.mode, MODES)}")
    if options.mode == MODES[0]:
        if options.real_time_factor is not None:
            raise FlockError(
                "--real-time-factor applies to a free flight only: add --mode free, or leave it out"
            )
        if told:
            raise FlockError(
                f"real_time_factor = {told:g} in {options.config} applies to a free flight only: "
                "add --mode free, or leave it out"
            )
        return 0.0
    for option, given in (("--window", options.window), ("--resume", options.resume)):
        if given is not None:
            raise FlockError(
                f"{option} and --mode free exclude each other: a free flight has no window "
                "and can't be continued; leave one out"
            )
    return positive_number("--real-time-factor", _said(options.real_time_factor, told or 1))


def _said(option: str | None, otherwise: object) -> str:
    """Return the text of an option; without the option, `otherwise` as text."""
    return str(otherwise) if option is None else option


def _go_on(output: Path, plan: Plan) -> None:
    """Cut the bag in `output` after its last row before any damage, so that it can continue."""
    from flock_sim.recording.flight_writer import lay_down

    run = lay_down(output, plan.configuration, grants=True, stages=plan.record_stages, resume=True)
    if run.bag.aside is not None:
        note(
            f"{run.bag.path} is damaged or lacks steps, and is kept as {run.bag.aside.name}: the "
            f"flight continues from step {max(run.saved, 0)}"
        )
    note(f"continuing {output}")


def main() -> NoReturn:
    """Run the `fly` executable."""
    # A process with threads of a mathematics library can't be forked. No flight needs them.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    end_process(run_tool(tool))


if __name__ == "__main__":
    main()
