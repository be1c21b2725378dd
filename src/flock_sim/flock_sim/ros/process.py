# SPDX-License-Identifier: Apache-2.0
"""The frame of a node process: arguments, parameters, signals, executor and exit status."""

from __future__ import annotations

import os
import secrets
import signal
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import rclpy
from rclpy.context import Context
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.utilities import remove_ros_args

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.configuration.operation import OPERATION, declared_by
from flock_sim.console.arguments import Parser, note, positive_number, run_tool
from flock_sim.console.signals import SUPERVISED, Stop, end_with_parent
from flock_sim.console.stdout import results_only_on_stdout
from flock_sim.errors import FlockError
from flock_sim.ros.discovery import NETWORK_HELP, prepare_discovery
from flock_sim.ros.fastdds_shutdown import leave
from flock_sim.ros.log import ros_context, warn
from flock_sim.ros.parameters.given import is_renamed, parameter_reader, what_is_given
from flock_sim.ros.settings_check import check_settings
from flock_sim.ros.watchdog import Watchdog


@dataclass(frozen=True)
class Process:
    """The task of a node process, and its ROS context."""

    configuration: FlockConfiguration
    operation: Mapping[str, Any]
    context: Context
    stop: Stop
    supervised: bool
    settle: Callable[[], None]
    """Call this once the nodes exist: no second node has the name of one of them from then on.

    The node that read the parameters is destroyed here if it was renamed to that name, and with the
    process if not. Were it destroyed before the nodes exist, the DDS participant of the process
    would be destroyed too, and made again. If it is destroyed while other processes discover its
    endpoints, these may wait for the next heartbeat of the discovery, which is 1 s away.
    """

    def watchdog(self, node: Node) -> Watchdog:
        """Return the watchdog of this process. Under `fly` it is silent: the clock reports."""
        silent = self.supervised
        return Watchdog(
            self.operation["timeout"], lambda line: None if silent else warn(node, line)
        )


@contextmanager
def executing(kind: str, context: Context) -> Iterator[Executor]:
    """Yield an executor of this `kind`; its nodes are destroyed at the end.

    The first node logs a FlockError that ends its process: `ros2 topic echo /rosout` and log files
    must say why a node is gone.
    """
    executor = make_executor(kind, context)
    try:
        yield executor
    except FlockError as error:
        for node in executor.get_nodes()[:1]:
            node.get_logger().fatal(str(error))
        raise
    finally:
        nodes = executor.get_nodes()
        for node in nodes:
            executor.remove_node(node)
        leave(context, nodes)
        executor.shutdown()


def make_executor(kind: str, context: Context) -> Executor:
    """Return an executor: "events" (if rclpy has it) or "single"."""
    if kind == "events":
        try:
            from rclpy.experimental import EventsExecutor
        except ImportError:
            note("note: this rclpy has no events executor; the single-threaded executor is used")
        else:
            return EventsExecutor(context=context)
    return SingleThreadedExecutor(context=context)


def new_incarnation() -> int:
    """Return a number that distinguishes a node from its earlier incarnations."""
    return secrets.randbits(64)


def run_node(
    name: str, description: str, examples: str, work: Callable[[Process], None]
) -> Callable[[Sequence[str] | None], int]:
    """Return the `main` of a node executable that does `work` and exits with its status."""

    def tool(arguments: Sequence[str]) -> int:
        told = f"{description}\n\n{_parameters(name)}"
        parser = Parser(f"{name} --ros-args", told, examples)
        parser.prog = f"./flock {name}"
        parser.usage = (
            f"./flock {name} [-h] [--timeout S] [--network] "
            "--ros-args [-p KEY:=VALUE]... [--params-file FILE]"
        )
        parser.add_argument("--timeout", metavar="S", help="the parameter `timeout`, in s")
        parser.add_argument("--network", action="store_true", help=NETWORK_HELP)
        options = parser.parse_args(_without_ros_arguments(name, arguments))
        timeout = None
        if options.timeout is not None:
            timeout = positive_number("--timeout", options.timeout)
        supervised = SUPERVISED in os.environ
        stop = Stop(heed_interrupt=not supervised)
        if supervised:
            _follow_parent()
        prepare_discovery(options.network)
        with results_only_on_stdout():
            context = ros_context(arguments, quiet=supervised)
            try:
                with parameter_reader(name, context) as reader:
                    if not supervised:  # `fly` checks for all of its processes
                        check_settings(context.get_domain_id())
                    configuration, operation = what_is_given(name, reader, arguments)
                    if timeout is not None:
                        operation["timeout"] = timeout
                    settle = reader.destroy_node if is_renamed(reader, name) else lambda: None
                    work(Process(configuration, operation, context, stop, supervised, settle))
            finally:
                rclpy.try_shutdown(context=context)
        return stop.exit_status

    def main(arguments: Sequence[str] | None = None) -> int:
        return run_tool(tool, arguments)

    return main


def _parameters(name: str) -> str:
    """Return the help on the parameters of the operation of a node."""
    lines = ["parameters, besides the keys of the configuration file:"]
    for key in declared_by(name):
        parameter = OPERATION[key]
        default = str(parameter.default).lower().removesuffix(".0")
        given = "" if key in ("index", "output") else f" ({default})"
        lines.append(f"  {key:17} {parameter.meaning}{given}")
    return "\n".join(lines)


def _without_ros_arguments(name: str, arguments: Sequence[str]) -> list[str]:
    """Return the arguments that are not for ROS. Raises FlockError if ROS can't read the others."""
    return check_ros_arguments(arguments, f"; ./flock {name} --help shows their form")


def check_ros_arguments(arguments: Sequence[str], hint: str = "") -> list[str]:
    """Return the arguments that are not for ROS.

    Raises FlockError, with `hint`, if ROS can't read the others.
    """
    try:
        return list(remove_ros_args(["", *arguments])[1:])
    except (
        rclpy_implementation.RCLInvalidROSArgsError,
        rclpy_implementation.UnknownROSArgsError,
    ) as error:
        # After "at" comes the place in the sources of rcl, which does not help a user.
        words = str(error).partition(", at /")[0].replace("\n", " ")
        reason = words.removeprefix("Failed to parse ROS arguments: ").strip()
        raise FlockError(f"ROS arguments: {reason}{hint}") from error


def _follow_parent() -> None:
    """Leave Ctrl-C to the parent, which ends the flight in order, and end when it ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    end_with_parent()
    if str(os.getppid()) != os.environ[SUPERVISED]:
        raise FlockError("the process that started this one has ended; start the flight again")
