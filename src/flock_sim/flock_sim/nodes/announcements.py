# SPDX-License-Identifier: Apache-2.0
"""Messages of the clock and the recorder to all birds: one subscription per process."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from flock_interfaces.msg import Checkpoint, Grant
from flock_sim.messages import topics
from flock_sim.messages import types as messages

if TYPE_CHECKING:
    from flock_sim.nodes.bird import BirdNode


class Announcements:
    """Grants and checkpoints, on their way to the birds of one process.

    With one subscription per bird, the clock would send every grant to each bird. The start of a
    flock of hundreds would take longer too, since discovery of endpoints is most of its work.
    """

    def __init__(self, birds: Sequence[BirdNode]) -> None:
        """Subscribe for `birds`, with the node of the first one."""
        self._birds = birds
        self._grants = birds[0].subscribe_drained(Grant, topics.GRANT_TOPIC)
        self._checkpoints = birds[0].subscribe_drained(Checkpoint, topics.CHECKPOINT_TOPIC)

    def drain(self) -> bool:
        """Take all messages and pass them to all birds; return whether any bird accepted one."""
        moved = False
        while (data := self._grants.take()) is not None:
            for bird in self._birds:
                moved |= bird.hear(messages.Grant, bird.protocol.receive_grant, data)
        while (data := self._checkpoints.take()) is not None:
            for bird in self._birds:
                moved |= bird.hear(messages.Checkpoint, bird.protocol.receive_checkpoint, data)
        return moved
