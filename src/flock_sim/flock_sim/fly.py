# SPDX-License-Identifier: Apache-2.0
"""The composed launcher: a whole flock over ROS 2 with one command."""

from __future__ import annotations

import argparse
import signal
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

from flock_sim.bag.output import claim_output
from flock_sim.command_line import (
    Parser,
    add_flock_options,
    flock_configuration,
    note,
    positive_number,
    run_tool,
    whole_number,
)
from flock_sim.core import topics
from flock_sim.core.configuration import FlockConfiguration
from flock_sim.core.free_flight import check_free
from flock_sim.core.spelling import nearest
from flock_sim.core.timekeeper import Timekeeper, new_run_id
from flock_sim.crew import Crew
from flock_sim.discovery import NETWORK_HELP, own_domain, prepare_discovery
from flock_sim.errors import FlockError
from flock_sim.nodes import EXECUTORS
from flock_sim.progress import progress_bar
from flock_sim.recording import lay_down
from flock_sim.report import add_output_options, output_directory, report
from flock_sim.resume import Resumable, resumable
from flock_sim.shares import shares
from flock_sim.standard_output import results_only_on_stdout
from flock_sim.times import Times

PATIENCE_OF_CREW = 30.0
"""How much longer, in s, than the clock the others wait: it is the clock that ends a flight."""

WINDOW = 64
"""Steps that birds are granted ahead."""

TIMEOUT = "60"
"""Longest standstill, in s."""

JOIN_LIMIT = 60.0
"""How long, in s, the others may take to end after the flight has."""

EXAMPLES = """\
  ./flock fly                                         thirteen geese to their steady state
  ./flock fly --birds 7 --t-max 1e5 --processes 2     seven birds in two processes
  ./flock fly --span-ratio 4=0.95,1.0,1.05            three flocks at once, bird 4 differs
  ./flock fly --config flock.yaml --output runs/mine --force
  ./flock fly --resume runs/mine                      goes on with a flight that was cut short
  ./flock fly --mode free --t-max 500                 21 s in which nobody waits for anybody"""

MODES = ("lockstep", "free")
"""Whether birds wait for each other: the first is the default, and the one that is exact."""


@dataclass(frozen=True)
class Plan:
    """A flight: what is flown, and how."""

    configuration: FlockConfiguration
    output: Path | None
    processes: int
    timeout: float
    begun: float
    """Monotonic time, in s, at which it was asked for."""
    window: int = WINDOW
    executor: str = EXECUTORS[0]
    record_stages: bool = False
    respawn: bool = True
    resume: bool = False
    real_time_factor: float = 0.0
    """How much faster than real time it is flown freely; 0: in lockstep."""
    stopwatch: Path | None = None
    """Directory in which the processes of birds tell where their time went; None: they don't."""

    def times(self) -> Times:
        """Return where the time of all processes of birds went; they were told to tell."""
        assert self.stopwatch is not None
        return Times.sum(map(Times.read, sorted(self.stopwatch.iterdir())))


def tool(arguments: Sequence[str]) -> int:
    """Fly a flock over ROS 2, record it, and say what came of it."""
    options = _parser().parse_args(arguments)
    resumed = resumable(options.resume, options) if options.resume else None
    plan = _plan(options, resumed)
    if resumed and resumed.complete:
        note(f"{options.resume} is complete: nothing to go on with")
        how = dict.fromkeys(("steps_per_second", "start_seconds", "wall_seconds"), 0.0)
        counts = dict.fromkeys(("steps_flown_again", "rewinds", "restarts"), 0)
        flight = {**how, **counts, "output": str(options.resume)}
        report(flight, plan.configuration, options.json)
        return 0
    with on_ros(options.network):
        if plan.output is not None:
            _prepare(plan.output, plan, options.force)
        flown = fly(plan)
    flight = {
        **flown,
        "wall_seconds": time.monotonic() - plan.begun,
        "output": None if plan.output is None else str(plan.output),
    }
    report(flight, plan.configuration, options.json)
    return 0


def _parser() -> Parser:
    parser = Parser(
        "fly", "Fly a flock over ROS 2: every bird a node, recorded as a bag.", EXAMPLES
    )
    add_flock_options(parser)
    add_output_options(parser)
    parser.add_argument(
        "--resume",
        metavar="RUN",
        type=Path,
        help="go on with a flight that was cut short, from the last step in its bag",
    )
    how = parser.add_argument_group("how it is flown", "none of these changes a bit of the result")
    free = parser.add_argument_group("free flight", "the real thing, which no two flights repeat")
    free.add_argument(
        "--mode",
        metavar="|".join(MODES),
        default=MODES[0],
        help="whether birds wait for each other's messages, or step by their own timers (lockstep)",
    )
    free.add_argument(
        "--real-time-factor",
        metavar="F",
        help="how much faster than real time a free flight is (1)",
    )
    how.add_argument("--processes", metavar="P", default="1", help="processes for the birds (1)")
    how.add_argument(
        "--window", metavar="W", help=f"steps granted ahead; 1 is strict lockstep ({WINDOW})"
    )
    how.add_argument(
        "--executor", metavar="|".join(EXECUTORS), default=EXECUTORS[0], help="of rclpy (events)"
    )
    how.add_argument(
        "--timeout",
        metavar="S",
        default=TIMEOUT,
        help=f"longest standstill before giving up, in s ({TIMEOUT})",
    )
    how.add_argument(
        "--no-respawn", action="store_true", help="end the flight when a process of it is killed"
    )
    how.add_argument("--network", action="store_true", help=NETWORK_HELP)
    how.add_argument("--record-stages", action="store_true", help="record RK4 stages too")
    how.add_argument("--no-record", action="store_true", help="fly without a bag")
    return parser


def _plan(options: argparse.Namespace, resumed: Resumable | None) -> Plan:
    configuration = resumed.configuration if resumed else flock_configuration(options)
    if options.executor not in EXECUTORS:
        raise FlockError(f"--executor {options.executor}: {nearest(options.executor, EXECUTORS)}")
    if options.no_record and options.record_stages:
        raise FlockError("--record-stages and --no-record exclude each other: leave one out")
    stages = resumed.stages if resumed else options.record_stages
    timeout = positive_number("--timeout", options.timeout)
    factor = _factor(options)
    if factor:
        check_free(configuration, factor, timeout, stages)
    topics.steps_ahead(configuration, stages)  # refuses what can't be recorded
    output = options.resume or (None if options.no_record else output_directory(options, "fly"))
    return Plan(
        configuration,
        output,
        whole_number("--processes", options.processes, 1, configuration.birds),
        timeout,
        time.monotonic(),
        whole_number("--window", options.window or str(WINDOW), 1),
        options.executor,
        stages,
        not options.no_respawn and not factor,
        resumed is not None,
        real_time_factor=factor,
    )


def _factor(options: argparse.Namespace) -> float:
    """Return the real-time factor, 0 in lockstep. Raises FlockError on what excludes the mode."""
    if options.mode not in MODES:
        raise FlockError(f"--mode {options.mode}: {nearest(options.mode, MODES)}")
    if options.mode == MODES[0]:
        if options.real_time_factor is not None:
            raise FlockError(
                "--real-time-factor is of a free flight, and lockstep is as fast as it can be: add "
                "--mode free, or leave it out"
            )
        return 0.0
    for option, given in (("--window", options.window), ("--resume", options.resume)):
        if given is not None:
            raise FlockError(
                f"{option} and --mode free exclude each other: a free flight holds nobody back, "
                "and can't be gone on with; leave one out"
            )
    return positive_number("--real-time-factor", options.real_time_factor or "1")


def _prepare(output: Path, plan: Plan, force: bool) -> None:
    """Have the beginning of a bag in `output`: from then on the flight can be resumed."""
    if plan.resume:
        note(f"going on with {output}")
        return
    begin_bag(output, plan, force)
    note(f"recording to {output}")


def begin_bag(output: Path, plan: Plan, force: bool = False) -> None:
    """Make `output` the beginning of the bag of `plan`. Raises FlockError as `claim_output`."""
    claim_output(output, force)
    lay_down(
        output,
        plan.configuration,
        grants=True,
        stages=plan.record_stages,
        factor=plan.real_time_factor,
    )


@contextmanager
def on_ros(network: bool = False) -> Iterator[None]:
    """Be ready to fly in the block: on a ROS domain, and ending in order whoever ends us."""
    prepare_discovery(network)
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, _terminated)
    with own_domain(), results_only_on_stdout():
        yield


def fly(plan: Plan) -> dict[str, Any]:
    """Fly `plan` to its end; return how that went: its rate, and what recovering has cost.

    The bag was begun where there is one, and `on_ros` is around it.
    """
    configuration = plan.configuration
    run_id = new_run_id()
    common = {
        "run_id": run_id,
        "executor": plan.executor,
        "timeout": plan.timeout + PATIENCE_OF_CREW,
        "real_time_factor": plan.real_time_factor,
    }
    with Crew(configuration.parameters(), plan.respawn) as crew:
        if plan.output is not None:
            recorder = {
                **common,
                "output": str(plan.output.absolute()),
                "resume": True,
                "record_stages": plan.record_stages,
            }
            crew.start("the recorder", "flock_sim.nodes.recorder", recorder, to_the_end=True)
        for birds in shares(configuration.birds, plan.processes):
            own: dict[str, object] = {**common, "indices": birds}
            if plan.stopwatch is not None:
                own["stopwatch"] = str(
                    plan.stopwatch.absolute() / f"birds_from_{birds[0]:02d}.json"
                )
            crew.start(_birds(birds), "flock_sim.nodes.bird", own)
        return _keep_time(plan, run_id, crew)


def _keep_time(plan: Plan, run_id: int, crew: Crew) -> dict[str, Any]:
    """Be the clock of the flight."""
    # Imported here, while the others are starting: it takes as long for us as for them.
    import rclpy

    from flock_sim.nodes.clock import OWN, ClockNode, first_epoch, keep_time
    from flock_sim.nodes.parameters import declare
    from flock_sim.nodes.patience import Patience
    from flock_sim.nodes.process import executing, ros_context

    configuration = plan.configuration
    keeper = Timekeeper(
        configuration,
        run_id,
        plan.window,
        plan.output is not None,
        plan.record_stages,
        first_epoch(),
        plan.real_time_factor,
    )
    furthest = -1
    context = ros_context(["--ros-args", "--disable-external-lib-logs"])
    try:
        with (
            executing(plan.executor, context) as executor,
            progress_bar("flying", configuration) as show,
        ):

            def watch() -> None:
                nonlocal furthest
                furthest = max(furthest, keeper.step)
                show(max(keeper.step, 0))
                crew.check(furthest)

            depth = topics.depth(topics.CLOCK_TOPIC, configuration)
            clock = ClockNode(keeper, depth, context=context)
            operation = {**vars(plan), "run_id": run_id, "record": plan.output is not None}
            declare(clock, configuration, operation, OWN)
            executor.add_node(clock)
            begun, ended = keep_time(clock, executor, Patience(plan.timeout, note), watch)
            watch()
            clock.release()
            crew.join(JOIN_LIMIT)
    finally:
        rclpy.try_shutdown(context=context)
    return {
        "steps_per_second": keeper.distance / (ended - begun) if ended > begun else 0.0,
        "start_seconds": begun - plan.begun,
        "steps_flown_again": keeper.rewinds.steps,
        "rewinds": keeper.rewinds.count,
        "restarts": crew.deaths,
    }


def _birds(birds: list[int]) -> str:
    return (
        f"bird {birds[0]}" if len(birds) == 1 else f"the process of birds {birds[0]}..{birds[-1]}"
    )


def _terminated(signum: int, frame: object) -> NoReturn:
    """End in order when somebody ends us: as with Ctrl-C, but with the status that they expect."""
    sys.exit(128 + signum)


def main() -> int:
    """Run the `fly` executable."""
    return run_tool(tool)


if __name__ == "__main__":
    sys.exit(main())
