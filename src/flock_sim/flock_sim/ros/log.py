# SPDX-License-Identifier: Apache-2.0
"""Log messages of nodes, through the loggers of ROS: on /rosout, in log files and on the terminal.

The nodes of `fly` and of tools belong to a quiet context: ROS prints none of their messages and
writes no log files. What the user must see is then printed as a note.
"""

from __future__ import annotations

from collections.abc import Sequence
from weakref import WeakSet

import rclpy
from rclpy.context import Context
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from flock_sim.console.arguments import note

_QUIET = ("--ros-args", "--disable-stdout-logs", "--disable-external-lib-logs", "--")

_quiet: WeakSet[Context] = WeakSet()


def ros_context(arguments: Sequence[str] = (), *, quiet: bool = True) -> Context:
    """Return a new ROS context without signal handlers; `quiet`: a quiet one.

    The user's ROS `arguments` override that: with `--enable-stdout-logs`, ROS prints all messages.
    """
    context = Context()
    rclpy.init(
        args=[*(_QUIET if quiet else ()), *arguments],
        context=context,
        signal_handler_options=SignalHandlerOptions.NO,
    )
    if quiet:
        _quiet.add(context)
    return context


def warn(node: Node, text: str) -> None:
    """Log a warning of `node`; print it, too, if ROS does not."""
    node.get_logger().warning(text)
    if node.context in _quiet:
        note(f"warning: {text}")
