# SPDX-License-Identifier: Apache-2.0
"""Somebody else on the ROS domain of a test's terminal: a node in the process of the test."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from flock_sim.discovery import PROFILES, prepare_discovery
from flock_sim.nodes.departure import leave
from flock_sim.nodes.endpoints import latched
from flock_sim.nodes.process import ros_context
from terminal import Terminal, ports

DEADLINE = 60.0
"""Time, in s, within which a node must answer, or say what is waited for."""


class Visitor:
    """Listens to a flock, asks it for things, and talks to it."""

    def __init__(self, terminal: Terminal, context: Context) -> None:
        """Be a node on the terminal's domain."""
        self.node = Node(
            "visitor", context=context, start_parameter_services=False, enable_rosout=False
        )
        self._terminal = terminal
        self._executor = SingleThreadedExecutor(context=context)
        self._executor.add_node(self.node)

    def close(self) -> None:
        """Leave."""
        self._executor.shutdown()
        leave(self.node.context, [self.node])

    def until(self, condition: Callable[[], Any]) -> Any:
        """Serve the node until `condition` is true, and return what it gave."""
        deadline = time.monotonic() + DEADLINE
        while not (value := condition()):
            assert time.monotonic() < deadline, self._what_is_known()
            self._terminal.look()
            self._executor.spin_once(timeout_sec=0.05)
        return value

    def ask(self, kind: Any, name: str, **request: Any) -> Any:
        """Call a service, and return what it answers."""
        client = self.node.create_client(kind, name)
        try:
            assert client.wait_for_service(DEADLINE), f"{name}: {self._what_is_known()}"
            future = client.call_async(kind.Request(**request))
            self.until(future.done)
            return future.result()
        finally:
            self.node.destroy_client(client)

    def _what_is_known(self) -> str:
        """Return what tells apart why nothing was heard: others gone, or not found."""
        listening = {pid: ports(pid) for pid in (os.getpid(), *self._terminal.processes())}
        return (
            f"not within {DEADLINE:g} s; nodes known: {self.node.get_node_names()}; "
            f"processes and the ports on which they listen: {listening}"
        )

    def hear(self, kind: Any, topic: str, *, raw: bool = False, depth: int = 100) -> list[Any]:
        """Return a list that grows with the messages on a latched topic."""
        heard: list[Any] = []
        self.node.create_subscription(kind, topic, heard.append, latched(depth), raw=raw)
        return heard

    def diagnostics(self, who: str) -> list[DiagnosticStatus]:
        """Return a list that grows with what /diagnostics tells of `who`, once a second."""
        heard: list[DiagnosticStatus] = []

        def hear(array: DiagnosticArray) -> None:
            heard.extend(status for status in array.status if status.name == who)

        self.node.create_subscription(DiagnosticArray, "/diagnostics", hear, 10)
        return heard


def values(status: DiagnosticStatus) -> dict[str, str]:
    """Return what a status tells, by key."""
    return {pair.key: pair.value for pair in status.values}


def tell_fast_dds(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have Fast DDS in this process know what the tools tell it: it reads that once."""
    for name in PROFILES:
        monkeypatch.setenv(name, "")
    prepare_discovery()


@contextmanager
def visiting(terminal: Terminal, monkeypatch: pytest.MonkeyPatch) -> Iterator[Visitor]:
    """Give a visitor of what is started in `terminal`."""
    for name in ("ROS_DOMAIN_ID", "ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_LOG_DIR"):
        monkeypatch.setenv(name, terminal.environment[name])
    tell_fast_dds(monkeypatch)
    context = ros_context(["--ros-args", "--disable-external-lib-logs"])
    visitor = Visitor(terminal, context)
    try:
        yield visitor
    finally:
        visitor.close()
        rclpy.try_shutdown(context=context)
