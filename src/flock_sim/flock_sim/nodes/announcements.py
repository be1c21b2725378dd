# SPDX-License-Identifier: Apache-2.0
"""What the clock and the recorder say to all birds: heard once in a process, for all its birds."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from flock_interfaces.msg import Checkpoint, Grant
from flock_sim.core import messages, topics

if TYPE_CHECKING:
    from flock_sim.nodes.bird import BirdNode


class Announcements:
    """Grants and checkpoints, on their way to the birds of one process.

    A subscription for each bird would make the clock send every grant to each of them; and starting
    a flock of hundreds is mostly the work of making endpoints known.
    """

    def __init__(self, birds: Sequence[BirdNode]) -> None:
        """Listen for `birds`, as the first of them."""
        self._birds = birds
        self._grants = birds[0].subscribe_drained(Grant, topics.GRANT_TOPIC)
        self._checkpoints = birds[0].subscribe_drained(Checkpoint, topics.CHECKPOINT_TOPIC)

    def drain(self) -> bool:
        """Take what has come, and let all birds hear it; return whether it was for any of them."""
        moved = False
        while (data := self._grants.take()) is not None:
            for bird in self._birds:
                moved |= bird.hear(messages.Grant, bird.protocol.receive_grant, data)
        while (data := self._checkpoints.take()) is not None:
            for bird in self._birds:
                moved |= bird.hear(messages.Checkpoint, bird.protocol.receive_checkpoint, data)
        return moved
