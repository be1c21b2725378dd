# SPDX-License-Identifier: Apache-2.0
"""Parameter services of a process of several birds, created one bird after the other in flight.

The services of one node are twelve endpoints, which take 10 ms or more to create. At the start,
they would delay a flight of hundreds of birds by many seconds.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterable

from rclpy.node import Node
from rclpy.parameter_service import ParameterService

SHARE = 0.05
"""Largest share of the time of a process that the creation of services takes."""

WAIT = 5.0
"""Time after which a process that does not fly yet creates services, in s."""


class LateParameters:
    """The nodes of a process that lack parameter services."""

    def __init__(self, nodes: Iterable[Node], declare: Callable[[Node], None]) -> None:
        """Wait for the flight; `declare` declares the parameters of a node."""
        self._lacking = deque(nodes)
        self._declare = declare
        self._due = time.monotonic() + WAIT

    def begin(self) -> None:
        """Create services from now on."""
        self._due = min(self._due, time.monotonic())

    def create_next(self) -> None:
        """Create the services of the next node, if it is due. The cost is negligible if not."""
        if not self._lacking or (begun := time.monotonic()) < self._due:
            return
        node = self._lacking.popleft()
        self._declare(node)
        node.parameter_service = ParameterService(node)
        took = time.monotonic() - begun
        self._due = begun + took / SHARE
