# SPDX-License-Identifier: Apache-2.0
"""The shell of a node process: arguments, parameters, signals, executor and exit status."""

from __future__ import annotations

import ctypes
import operator
import os
import secrets
import signal
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import rclpy
from rclpy.context import Context
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args

from flock_sim.command_line import Parser, note, positive_number, run_tool, whole_number
from flock_sim.core.configuration import MEANING, FlockConfiguration
from flock_sim.core.spelling import nearest
from flock_sim.crew import SUPERVISED
from flock_sim.discovery import NETWORK_HELP, prepare_discovery
from flock_sim.errors import FlockError
from flock_sim.nodes import EXECUTORS
from flock_sim.nodes.departure import leave
from flock_sim.nodes.patience import Patience
from flock_sim.standard_output import results_only_on_stdout
from flock_sim.stop import Stop

# How a node operates, as opposed to what is flown: any of the nodes may be given any of these.
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
    "stopwatch": "",
    "real_time_factor": 0.0,
}

# What every ROS 2 node may be given, and Flock has no use for.
OF_ROS = ("use_sim_time", "start_type_description_service", "qos_overrides")

PR_SET_PDEATHSIG = 1


@dataclass(frozen=True)
class Process:
    """What a node process was asked to do, and the ROS context that it does it in."""

    configuration: FlockConfiguration
    operation: Mapping[str, Any]
    context: Context
    stop: Stop
    supervised: bool
    settle: Callable[[], None]
    """To be called once the nodes are there: the one that read the parameters may go then.

    Had it gone before, the participant of the process would have gone with it, to be made again.
    """

    def patience(self) -> Patience:
        """Return how long this process waits: silently under `fly`, whose clock speaks for it."""
        return Patience(self.operation["timeout"], (lambda line: None) if self.supervised else note)


@contextmanager
def executing(kind: str, context: Context) -> Iterator[Executor]:
    """Give an executor of the `kind` asked for; its nodes are destroyed at the end."""
    executor = make_executor(kind, context)
    try:
        yield executor
    finally:
        nodes = executor.get_nodes()
        for node in nodes:
            executor.remove_node(node)
        leave(context, nodes)
        executor.shutdown()


def make_executor(kind: str, context: Context) -> Executor:
    """Return an executor: "events" (where rclpy has it) or "single"."""
    if kind == "events":
        try:
            from rclpy.experimental import EventsExecutor
        except ImportError:
            note("note: this rclpy has no events executor; the single-threaded one serves")
        else:
            return EventsExecutor(context=context)
    return SingleThreadedExecutor(context=context)


def new_life() -> int:
    """Return a number that tells a node from those that were it before, and died."""
    return secrets.randbits(64)


def ros_context(arguments: Sequence[str]) -> Context:
    """Return an initialised ROS context that leaves signals to us."""
    context = Context()
    rclpy.init(
        args=list(arguments), context=context, signal_handler_options=SignalHandlerOptions.NO
    )
    return context


def run_node(
    name: str, description: str, examples: str, work: Callable[[Process], None]
) -> Callable[[Sequence[str] | None], int]:
    """Return the `main` of a node executable that does `work` and exits with its status."""

    def tool(arguments: Sequence[str]) -> int:
        parser = Parser(f"{name} --ros-args", description, examples)
        parser.prog = f"./flock {name}"
        parser.usage = (
            f"./flock {name} [-h] [--timeout S] [--network] "
            "--ros-args [-p KEY:=VALUE]... [--params-file FILE]"
        )
        parser.add_argument("--timeout", metavar="S", help="the parameter `timeout`, in s")
        parser.add_argument("--network", action="store_true", help=NETWORK_HELP)
        options = parser.parse_args(_without_ros_arguments(name, arguments))
        supervised = SUPERVISED in os.environ
        stop = Stop(heed_interrupt=not supervised)
        if supervised:
            _follow_parent()
        prepare_discovery(options.network)
        with results_only_on_stdout():
            context = ros_context(arguments)
            try:
                with _reader(name, context) as reader:
                    configuration, operation = _parameters(reader)
                    if options.timeout is not None:
                        operation["timeout"] = positive_number("--timeout", options.timeout)
                    settle = reader.destroy_node
                    work(Process(configuration, operation, context, stop, supervised, settle))
            finally:
                rclpy.try_shutdown(context=context)
        return stop.exit_status

    def main(arguments: Sequence[str] | None = None) -> int:
        return run_tool(tool, arguments)

    return main


def _without_ros_arguments(name: str, arguments: Sequence[str]) -> list[str]:
    """Return the arguments that are not ROS's. Raises FlockError where ROS can't read its own."""
    try:
        return list(remove_ros_args([name, *arguments])[1:])
    except (
        rclpy_implementation.RCLInvalidROSArgsError,
        rclpy_implementation.UnknownROSArgsError,
    ) as error:
        # After "at" comes the place in the sources of rcl, of use to nobody here.
        words = str(error).partition(", at /")[0].replace("\n", " ")
        reason = words.removeprefix("Failed to parse ROS arguments: ").strip()
        raise FlockError(
            f"ROS arguments: {reason}; ./flock {name} --help shows how they are written"
        ) from error


def _follow_parent() -> None:
    """Leave Ctrl-C to the parent, which ends the flight in order, and do not outlive it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGTERM)
        if str(os.getppid()) != os.environ[SUPERVISED]:
            raise FlockError("the process that started this one is gone; start the flight again")


@contextmanager
def _reader(name: str, context: Context) -> Iterator[Node]:
    """Give a node that has the parameters given to this process.

    The real one, which comes after it, is named by what they say.
    """
    reader = Node(
        f"{name}_parameters",
        namespace="/flock",
        context=context,
        start_parameter_services=False,
        enable_rosout=False,
        automatically_declare_parameters_from_overrides=True,
    )
    try:
        yield reader
    finally:
        leave(context, [reader])  # which does nothing to it where it has gone already


def _parameters(reader: Node) -> tuple[FlockConfiguration, dict[str, Any]]:
    """Return what was flown and how, from the ROS parameters that `reader` has."""
    given = {key: p.value for key, p in reader.get_parameters_by_prefix("").items()}
    operation = dict(OPERATION)
    flown = {}
    for key, value in given.items():
        if key in OPERATION:
            operation[key] = _like(key, value, OPERATION[key])
        elif key.partition(".")[0] not in OF_ROS:
            if key not in MEANING:
                raise FlockError(
                    f"unknown parameter {key!r}: {nearest(key, [*MEANING, *OPERATION])}"
                )
            flown[key] = value
    _check(operation)
    return FlockConfiguration.from_parameters(flown), operation


def _check(operation: Mapping[str, Any]) -> None:
    """Raise FlockError where the operation of a node is out of range."""
    positive_number("timeout", str(operation["timeout"]))
    for key, least in (("window", 1), ("run_id", 0)):
        whole_number(key, str(operation[key]), least)
    if operation["real_time_factor"]:
        positive_number("real_time_factor", str(operation["real_time_factor"]))
    if operation["executor"] not in EXECUTORS:
        raise FlockError(
            f"executor {operation['executor']!r}: {nearest(operation['executor'], EXECUTORS)}"
        )


def _like(key: str, value: Any, default: Any) -> Any:
    """Return `value` if it is of the type of `default`; a whole number may stand for a real one."""
    if isinstance(default, list):
        try:
            return [operator.index(item) for item in value]
        except TypeError:
            raise FlockError(f"{key} = {value!r}: must be a list such as [1, 2]") from None
    if isinstance(default, float) and isinstance(value, int) and not isinstance(value, bool):
        value = float(value)
    if type(value) is not type(default):
        raise FlockError(
            f"{key} = {value!r}: must be a {type(default).__name__} such as {default!r}"
        )
    return value
