# SPDX-License-Identifier: Apache-2.0
"""The nodes of a flight under `ros2 launch`: their start, and the actions at their end."""

from __future__ import annotations

import json
import shlex
import signal
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager

from launch import LaunchContext
from launch.action import Action
from launch.actions import DeclareLaunchArgument, EmitEvent, LogInfo, TimerAction
from launch.events import Shutdown
from launch_ros.actions import Node

from flock_sim.errors import RunFailed
from flock_sim.launcher import exit_status
from flock_sim.launcher.fork_server import ForkServer
from flock_sim.launcher.forkable import CannotFork
from flock_sim.launcher.ros2_launch_arguments import Arguments, refuse_others
from flock_sim.messages.topics import RECORDER, bird_name
from flock_sim.protocol.clock import new_run_id
from flock_sim.ros.discovery import own_domain, prepare_discovery
from flock_sim.ros.parameters.node_parameters import CLOCK

LATE = 30.0
"""Longest time for the other nodes to end after the flight, in s."""

INTERRUPTED = (-signal.SIGINT, 128 + signal.SIGINT)
"""Exit statuses of a node after Ctrl-C. The launch gets the signal too, perhaps a moment later."""


def declare(arguments: Mapping[str, tuple[str, str]]) -> list[Action]:
    """Return the declarations of `arguments`: the default and the description of each."""
    return [
        DeclareLaunchArgument(name, default_value=default, description=description)
        for name, (default, description) in arguments.items()
    ]


class Flight:
    """The nodes of one flight, and the rules for their ends.

    They have their own ROS domain while `held` is open, like those of `fly`.

    A node that dies is restarted; a node that ends with status 0 is not. A node that fails or has
    bad input ends the launch, and so does the end of the flight.
    """

    def __init__(self, context: LaunchContext, known: Mapping[str, tuple[str, str]]) -> None:
        """Read the `known` arguments of the launch. Raises FlockError if one is wrong."""
        refuse_others(context.argv, list(known))
        given = context.launch_configurations
        texts = {name: given[name] for name in known}
        self.arguments = Arguments.read(texts, given.get("ros_namespace", ""))
        # The run id separates the birds of flights, but recorded data does not show its flight.
        prepare_discovery()
        self.held = ExitStack()
        self.held.enter_context(own_domain())
        self._run_id = new_run_id()
        self._prefix = self.held.enter_context(_fork_server())
        # It ends with status 0 when all is on disk, or flown. The other nodes are not needed then.
        self._last = RECORDER if self.arguments.record else CLOCK
        self._parts: dict[str, tuple[str, Mapping[str, object]]] = {}

    def clock(self) -> Node:
        """Return the clock."""
        return self._add(CLOCK, "clock", {"record": self.arguments.record})

    def recorder(self) -> list[Node]:
        """Return the recorder, if the flight is recorded."""
        if not self.arguments.record:
            return []
        bag = {"output": self.arguments.output, "resume": self.arguments.respawn}
        return [self._add(RECORDER, "recorder", bag)]

    def birds(self, indices: Sequence[int]) -> Node:
        """Return the birds of these numbers, in one process."""
        names = [bird_name(indices[0]), bird_name(indices[-1])]
        who = names[0] if len(indices) == 1 else "_to_".join(names)
        return self._add(who, "bird", {"indices": list(indices)})

    def ended(self, who: str, status: int) -> list[Action]:
        """Return the actions after node `who` has ended with `status`, as `subprocess` gives it.

        Raises RunFailed, which ends the launch, if `who` must not be restarted.
        """
        if exit_status.failed(status):
            reason = exit_status.WHY.get(status, "an error")
            raise RunFailed(f"{who} {exit_status.ended(status)} ({reason}): its error is above")
        if status in INTERRUPTED:
            return [LogInfo(msg=f"{who} was interrupted: the flight ends"), _end("interrupted")]
        if status == 0 or self._last not in self._parts:
            return self._gone(who)
        if not self.arguments.respawn:
            raise RunFailed(f"{who} {exit_status.ended(status)}: fly again, or with respawn:=true")
        return [
            LogInfo(msg=f"{who} {exit_status.ended(status)}: it is started again"),
            self._node(who),
        ]

    def _gone(self, who: str) -> list[Action]:
        """Return the actions when node `who` is no longer needed."""
        del self._parts[who]
        end = _end("the flight is over")
        if not self._parts:
            return [end]
        return [TimerAction(period=LATE, actions=[end])] if who == self._last else []

    def _add(self, who: str, executable: str, parameters: Mapping[str, object]) -> Node:
        self._parts[who] = (executable, parameters)
        return self._node(who)

    def _node(self, who: str) -> Node:
        executable, parameters = self._parts[who]
        birds = self.arguments.configuration.birds
        # Not as `parameters=`, for which launch_ros leaves files in the temporary directory. The
        # text after := is read as YAML, and JSON is valid YAML.
        words = ["--params-file", self.arguments.config] if self.arguments.config else []
        for key, value in {"run_id": self._run_id, "birds": birds, **parameters}.items():
            words += ["-p", f"{key}:={json.dumps(value, ensure_ascii=False)}"]
        return Node(
            package="flock_sim",
            executable=executable,
            exec_name=who,
            namespace=self.arguments.namespace or None,
            prefix=self._prefix,
            output="screen",
            ros_arguments=words,
            on_exit=lambda event, context: (
                [] if context.is_shutdown else self.ended(who, event.returncode)
            ),
        )


@contextmanager
def _fork_server() -> Iterator[str]:
    """Yield the prefix of a node command that uses a fork server; "" if none can exist."""
    try:
        server = ForkServer.spawn("flock_sim.launcher.preload:preload", listen=True)
    except CannotFork:
        yield ""
        return
    client = [sys.executable, "-P", "-m", "flock_sim.launcher.fork_client", server.address]
    try:
        yield shlex.join(client)
    finally:
        server.close()


def _end(reason: str) -> Action:
    return EmitEvent(event=Shutdown(reason=reason))
