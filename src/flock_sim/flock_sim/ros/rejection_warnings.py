# SPDX-License-Identifier: Apache-2.0
"""Rejection warnings: each reason to ignore messages is reported once per process."""

from __future__ import annotations

from collections import Counter

from rclpy.node import Node

from flock_sim.messages.rejection import AGAIN, STALE
from flock_sim.ros.log import warn


class RejectionWarnings:
    """The rejection warnings of one node, from its counts of ignored messages."""

    def __init__(
        self,
        node: Node,
        ignored_for: Counter[str],
        told: set[str] | None = None,
        logger: Node | None = None,
    ) -> None:
        """Warn for `node`; `told` holds the reasons already reported in its process.

        `logger` is the node that logs the warnings, by default the same.

        Stale messages are normal in a recovery, and repeated messages of waiting birds are normal
        after a loss. Neither is reported.
        """
        self._node = node
        self._logger = logger or node
        self._ignored_for = ignored_for
        self._told = set() if told is None else told
        self._told |= {AGAIN, STALE}

    def tell(self) -> None:
        """Warn of new reasons; the cost is negligible if there are none."""
        if self._ignored_for.keys() <= self._told:
            return
        for reason in self._ignored_for.keys() - self._told:
            self._told.add(reason)
            who = self._node.get_name()
            warn(self._logger, f"{who} ignores messages {reason}; /diagnostics counts them")
