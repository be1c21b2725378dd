# SPDX-License-Identifier: Apache-2.0
"""A flight over ROS 2: its plan, its processes, and the clock, which runs in this process."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from flock_sim.configuration.choices import EXECUTORS
from flock_sim.configuration.operation import OPERATION, declared_by
from flock_sim.console.arguments import LONGEST, note
from flock_sim.console.progress import progress_bar
from flock_sim.console.signals import Endings
from flock_sim.console.stdout import results_only_on_stdout
from flock_sim.launcher.partition import partition
from flock_sim.launcher.supervisor import Supervisor
from flock_sim.nodes.executables import module_of
from flock_sim.ros.discovery import own_domain, prepare_discovery

if TYPE_CHECKING:
    from flock_sim.configuration.flock_configuration import FlockConfiguration
    from flock_sim.recording.output_directory import Output
    from flock_sim.ros.parameters.node_parameters import FlightParameters

NODE_MARGIN = 30.0
"""Extra timeout of the other nodes over that of the clock, in s: the clock ends the flight."""

WINDOW: int = OPERATION["window"].default
"""Steps that birds are granted ahead."""

JOIN_LIMIT = 60.0
"""Longest time for the other processes to end after the flight, in s."""


@dataclass(frozen=True)
class Plan:
    """A flight: its configuration and its operation."""

    configuration: FlockConfiguration
    output: Path | None
    processes: int
    timeout: float
    begun: float
    """Monotonic time of its request, in s."""
    window: int = WINDOW
    executor: str = EXECUTORS[0]
    record_stages: bool = False
    respawn: bool = True
    resume: bool = False
    real_time_factor: float = 0.0
    """Real-time factor of a free flight; 0: lockstep."""
    told: FlightParameters | None = None
    """Operating parameters of the nodes from a parameter file."""
    from_file: tuple[str, ...] = ()
    """Keys of these parameters that options do not set."""
    clock_every: int = 0
    """Steps between two messages of /clock; 0: only recorded steps."""
    ros_arguments: tuple[str, ...] = ()
    """ROS arguments of all nodes."""

    @property
    def timeout_of_others(self) -> float:
        """Timeout of all nodes except the clock, in s."""
        return min(self.timeout + NODE_MARGIN, LONGEST)

    def operation(self, nodes: Iterable[str]) -> dict[str, Any]:
        """Return the parameters of the process of `nodes` that override the common ones."""
        return self.told.of(nodes, self.from_file) if self.told else {}


def begin_bag(output: Output, plan: Plan) -> None:
    """Write the beginning of the bag of `plan` to `output`; then the flight can be resumed.

    A replaced bag stays until the flight has begun. Raises FlockError as `lay_down` does.
    """
    from flock_sim.recording.flight_writer import lay_down

    lay_down(
        output.path,
        plan.configuration,
        grants=True,
        stages=plan.record_stages,
        replace=output.replaces,
        factor=plan.real_time_factor,
    )


@contextmanager
def on_ros(network: bool = False) -> Iterator[None]:
    """Prepare discovery and hold a ROS domain in the block."""
    prepare_discovery(network)
    with own_domain(), results_only_on_stdout():
        yield


def fly(plan: Plan) -> dict[str, Any]:
    """Fly `plan` to its end; return its rate and the cost of recovery.

    Call it within `on_ros`, after `begin_bag` if the flight is recorded.
    """
    from flock_sim.launcher.preload import preloaded_server
    from flock_sim.messages import topics
    from flock_sim.protocol.clock import new_run_id

    configuration = plan.configuration
    run_id = new_run_id()
    common = {
        "run_id": run_id,
        "executor": plan.executor,
        "timeout": plan.timeout_of_others,
        "real_time_factor": plan.real_time_factor,
    }
    server = preloaded_server(links=bool(configuration.links))
    with Supervisor(
        configuration.parameters(), plan.respawn, server, plan.ros_arguments
    ) as supervisor:
        if plan.output is not None:
            recorder = {
                **common,
                **plan.operation([topics.RECORDER]),
                "output": str(plan.output.absolute()),
                "resume": True,
                "record_stages": plan.record_stages,
            }
            supervisor.start("the recorder", module_of("recorder"), recorder, to_the_end=True)
        for birds in partition(configuration.birds, plan.processes):
            own = {**common, **plan.operation(map(topics.bird_name, birds)), "indices": birds}
            supervisor.start(_name_of(birds), module_of("bird"), own)
        return _keep_time(plan, run_id, supervisor)


def _keep_time(plan: Plan, run_id: int, supervisor: Supervisor) -> dict[str, Any]:
    """Run the clock of the flight."""
    import rclpy

    from flock_sim.messages import topics
    from flock_sim.nodes.clock import ClockNode, keep_time
    from flock_sim.protocol.clock import Timekeeper
    from flock_sim.ros.log import ros_context
    from flock_sim.ros.parameters.declared import declare
    from flock_sim.ros.process import executing
    from flock_sim.ros.settings_check import check_settings
    from flock_sim.ros.watchdog import Watchdog

    configuration = plan.configuration
    keeper = Timekeeper(
        configuration,
        run_id,
        plan.window,
        plan.output is not None,
        plan.record_stages,
        factor=plan.real_time_factor,
        clock_every=plan.clock_every,
    )
    furthest = -1
    context = ros_context(plan.ros_arguments)
    try:
        with (
            executing(plan.executor, context) as executor,
            progress_bar("flying", configuration) as show,
            Endings() as endings,
        ):

            def watch() -> None:
                nonlocal furthest
                endings.check()
                furthest = max(furthest, keeper.step)
                show(max(keeper.step, 0))
                supervisor.check(furthest)

            depth = topics.clock_depth(configuration, plan.clock_every)
            clock = ClockNode(keeper, depth, context=context)
            operation = {**vars(plan), "run_id": run_id, "record": plan.output is not None}
            declare(clock, configuration, operation, declared_by("clock"))
            executor.add_node(clock)
            check_settings(context.get_domain_id())
            with endings.deferred():
                begun, ended = keep_time(clock, executor, Watchdog(plan.timeout, note), watch)
            watch()
            clock.release()
            supervisor.join(JOIN_LIMIT)
    finally:
        rclpy.try_shutdown(context=context)
    steps, seconds = max(0, keeper.step - (keeper.began or 0)), ended - begun
    return {
        "steps_per_second": steps / seconds if seconds > 0.0 else 0.0,
        "start_seconds": begun - plan.begun,
        "steps_flown_again": keeper.rewinds.steps,
        "rewinds": keeper.rewinds.count,
        "restarts": supervisor.deaths,
        "last_step": keeper.end,
    }


def _name_of(birds: list[int]) -> str:
    return (
        f"bird {birds[0]}" if len(birds) == 1 else f"the process of birds {birds[0]}..{birds[-1]}"
    )
