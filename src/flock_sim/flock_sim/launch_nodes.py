# SPDX-License-Identifier: Apache-2.0
"""The nodes of a flight under `ros2 launch`: how they are started, and what follows their ends."""

from __future__ import annotations

import json
import signal
from collections.abc import Mapping, Sequence
from contextlib import ExitStack

from launch import LaunchContext
from launch.action import Action
from launch.actions import DeclareLaunchArgument, EmitEvent, LogInfo, TimerAction
from launch.events import Shutdown
from launch_ros.actions import Node

from flock_sim.core.timekeeper import new_run_id
from flock_sim.core.topics import RECORDER, bird_name
from flock_sim.discovery import own_domain, prepare_discovery
from flock_sim.errors import RunFailed
from flock_sim.launch_arguments import Arguments, refuse_others

CLOCK = "clock"

LATE = 30.0
"""How long, in s, the others may take to end once the flight is over."""

INTERRUPTED = (-signal.SIGINT, 128 + signal.SIGINT)
"""What Ctrl-C makes of a node: the launch hears of it too, perhaps a moment later."""

WHY = {1: "the run failed", 2: "bad input"}
"""The exit statuses that a node would have again if it were started again."""


def declare(arguments: Mapping[str, tuple[str, str]]) -> list[Action]:
    """Return the declarations of `arguments`: the default and the description of each."""
    return [
        DeclareLaunchArgument(name, default_value=default, description=description)
        for name, (default, description) in arguments.items()
    ]


class Flight:
    """The nodes of one flight, and the rules for their ends.

    They have a ROS domain of their own for as long as `held` is open, as those of `fly` have.

    One that dies is started again; one that ended well is not. One that refuses what it was given,
    or fails, ends the launch, and so does the end of the flight.
    """

    def __init__(self, context: LaunchContext, known: Mapping[str, tuple[str, str]]) -> None:
        """Read the arguments of the launch, of which it has `known`. Raises FlockError."""
        refuse_others(context.argv, list(known))
        given = context.launch_configurations
        self.arguments = Arguments.read({name: given[name] for name in known})
        # The run id keeps birds apart, but what is recorded does not tell whose it is.
        prepare_discovery()
        self.held = ExitStack()
        self.held.enter_context(own_domain())
        self._run_id = new_run_id()
        # Which ends well when all is on disk, or flown: nobody is needed after that.
        self._last = RECORDER if self.arguments.record else CLOCK
        self._parts: dict[str, tuple[str, Mapping[str, object]]] = {}

    def clock(self) -> Node:
        """Return the clock."""
        return self._add(CLOCK, "clock", {"record": self.arguments.record})

    def recorder(self) -> list[Node]:
        """Return the recorder, if there is to be one."""
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
        """Return what follows when `who` has ended with `status`: that of `subprocess`.

        Raises RunFailed, with which the launch ends, where `who` is not to be started again.
        """
        if status in WHY:
            raise RunFailed(f"{who} ended with status {status} ({WHY[status]}): its error is above")
        if status in INTERRUPTED:
            return [LogInfo(msg=f"{who} was interrupted: the flight ends"), _end("interrupted")]
        if status == 0 or self._last not in self._parts:
            return self._gone(who)
        if not self.arguments.respawn:
            raise RunFailed(f"{who} died: fly again, or with respawn:=true")
        return [LogInfo(msg=f"{who} died: it is started again"), self._node(who)]

    def _gone(self, who: str) -> list[Action]:
        """Return what follows now that `who` is no longer needed."""
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
        # Not as `parameters=`, for which launch_ros leaves files in the temporary directory. What
        # follows := is read as YAML, and JSON is that.
        words = ["--params-file", self.arguments.config] if self.arguments.config else []
        for key, value in {"run_id": self._run_id, "birds": birds, **parameters}.items():
            words += ["-p", f"{key}:={json.dumps(value, ensure_ascii=False)}"]
        return Node(
            package="flock_sim",
            executable=executable,
            exec_name=who,
            output="screen",
            ros_arguments=words,
            on_exit=lambda event, context: (
                [] if context.is_shutdown else self.ended(who, event.returncode)
            ),
        )


def _end(reason: str) -> Action:
    return EmitEvent(event=Shutdown(reason=reason))
