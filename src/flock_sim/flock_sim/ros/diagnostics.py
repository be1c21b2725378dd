# SPDX-License-Identifier: Apache-2.0
"""Reports of the nodes on /diagnostics, once a second."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Mapping

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node

EVERY = 1.0
"""Time between two reports, in s."""

QUEUE = 10

Status = tuple[bool, str, Mapping[str, object]]
"""Whether the node is well, a short text, and some values."""

OK, WARN = DiagnosticStatus.OK, DiagnosticStatus.WARN


class Diagnostics:
    """The reports of one node."""

    def __init__(self, node: Node) -> None:
        """Report for `node`."""
        self._node = node
        self._outlet = node.create_publisher(DiagnosticArray, "/diagnostics", QUEUE)
        self._due = time.monotonic()

    def tell(self, status: Callable[[], Status]) -> None:
        """Publish a report if one is due."""
        now = time.monotonic()
        if now < self._due:
            return
        self._due = now + EVERY
        well, words, values = status()
        name = self._node.get_fully_qualified_name().lstrip("/")
        told = DiagnosticStatus(
            level=OK if well else WARN,
            name=name.replace("/", ": "),
            message=words,
            hardware_id=name,
            values=[KeyValue(key=key, value=str(value)) for key, value in values.items()],
        )
        array = DiagnosticArray(status=[told])
        array.header.stamp = self._node.get_clock().now().to_msg()
        self._outlet.publish(array)


def ignored(counts: Counter[str]) -> dict[str, object]:
    """Return counts of ignored messages as values to report."""
    return {"ignored": counts.total(), **{f"ignored, {why}": n for why, n in counts.items()}}
