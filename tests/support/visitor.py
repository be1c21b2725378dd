# SPDX-License-Identifier: Apache-2.0
"""Another node on the ROS domain of a test's terminal, in the process of the test."""

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
from std_srvs.srv import Trigger

from flock_interfaces.srv import Stop
from flock_sim.ros.discovery import PROFILES, prepare_discovery
from flock_sim.ros.endpoints import latched
from flock_sim.ros.fastdds_shutdown import leave
from flock_sim.ros.log import ros_context
from support.terminal import Done, Job, Terminal, ports

DEADLINE = 60.0
"""Longest wait for an answer or a message of a node, in s."""


ASK_AGAIN = 1.0
"""Time after which a request to a clock is repeated, in s."""


class Visitor:
    """A node that listens to a flock, and calls its services."""

    def __init__(self, terminal: Terminal, context: Context) -> None:
        """Create a node on the terminal's domain."""
        self.node = Node(
            "visitor", context=context, start_parameter_services=False, enable_rosout=False
        )
        self._terminal = terminal
        self._clients: dict[str, Any] = {}
        self._executor = SingleThreadedExecutor(context=context)
        self._executor.add_node(self.node)

    def close(self) -> None:
        """Destroy the node."""
        self._executor.shutdown()
        leave(self.node.context, [self.node])

    def until(self, condition: Callable[[], Any]) -> Any:
        """Serve the node until `condition` is true, and return its value."""
        deadline = time.monotonic() + DEADLINE
        while not (value := condition()):
            assert time.monotonic() < deadline, self._what_is_known()
            self._terminal.look_sometimes()
            self._executor.spin_once(timeout_sec=0.05)
        return value

    def ask(self, kind: Any, name: str, **request: Any) -> Any:
        """Call a service, and return its response."""
        client = self.client(kind, name)
        assert client.wait_for_service(DEADLINE), f"{name}: {self._what_is_known()}"
        future = client.call_async(kind.Request(**request))
        self.until(future.done)
        return future.result()

    def client(self, kind: Any, name: str) -> Any:
        """Return the client of a service, which is made at the first call."""
        if name not in self._clients:
            self._clients[name] = self.node.create_client(kind, name)
        return self._clients[name]

    def stop(self, *jobs: Job) -> None:
        """Have the clock of `jobs` stop the flight. All jobs must end without an error.

        The request is repeated until it is answered: a killed clock stays discovered for a while,
        and requests to it are lost. A clock that has not yet discovered this node stops the flight
        without an answer: ROS drops it after 0.1 s.
        """
        client = self.node.create_client(Trigger, "/flock/clock/stop")
        asked, futures = 0.0, []
        deadline = time.monotonic() + DEADLINE
        while any(job.running for job in jobs):
            assert time.monotonic() < deadline, self._what_is_known()
            answered = any(future.done() for future in futures)
            if not answered and time.monotonic() > asked + ASK_AGAIN:
                asked = time.monotonic()
                futures.append(client.call_async(Trigger.Request()))
            self._terminal.look_sometimes()
            self._executor.spin_once(timeout_sec=0.05)
        for job in jobs:
            assert job.wait().status == 0, job.stderr
        assert futures, "the flight was over before it was stopped"
        assert all(future.result().success for future in futures if future.done())

    def stop_player(self, job: Job) -> Done:
        """Stop the player of `job`, and return what it has printed.

        It may end before it has found the client, which then gets no answer.
        """
        client = self.client(Stop, "/flock/player/stop")
        assert client.wait_for_service(DEADLINE), self._what_is_known()
        client.call_async(Stop.Request())
        self.until(lambda: not job.running)
        return job.wait()

    def _what_is_known(self) -> str:
        """Return the known nodes and ports, to distinguish missing nodes from failed discovery."""
        listening = {pid: ports(pid) for pid in (os.getpid(), *self._terminal.processes())}
        return (
            f"not within {DEADLINE:g} s; nodes known: {self.node.get_node_names()}; "
            f"processes and the ports on which they listen: {listening}"
        )

    def hear(self, kind: Any, topic: str, *, raw: bool = False, depth: int = 100) -> list[Any]:
        """Return a list to which messages on a latched topic are appended."""
        heard: list[Any] = []
        self.node.create_subscription(kind, topic, heard.append, latched(depth), raw=raw)
        return heard

    def diagnostics(self, who: str) -> list[DiagnosticStatus]:
        """Return a list to which statuses of `who` on /diagnostics are appended, once a second."""
        heard: list[DiagnosticStatus] = []

        def hear(array: DiagnosticArray) -> None:
            heard.extend(status for status in array.status if status.name == who)

        self.node.create_subscription(DiagnosticArray, "/diagnostics", hear, 10)
        return heard


def values(status: DiagnosticStatus) -> dict[str, str]:
    """Return the values of a status by key."""
    return {pair.key: pair.value for pair in status.values}


def tell_fast_dds(monkeypatch: pytest.MonkeyPatch) -> None:
    """Give Fast DDS in this process the tools' settings, which it reads only once."""
    for name in PROFILES:
        monkeypatch.setenv(name, "")
    prepare_discovery()


@contextmanager
def visiting(terminal: Terminal, monkeypatch: pytest.MonkeyPatch) -> Iterator[Visitor]:
    """Give a visitor on the domain of `terminal`."""
    for name in ("ROS_DOMAIN_ID", "ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_LOG_DIR"):
        monkeypatch.setenv(name, terminal.environment[name])
    tell_fast_dds(monkeypatch)
    context = ros_context()
    visitor = Visitor(terminal, context)
    try:
        yield visitor
    finally:
        visitor.close()
        rclpy.try_shutdown(context=context)
