# SPDX-License-Identifier: Apache-2.0
"""Where the stage messages of a bird's neighbours arrive.

There are two slots for each neighbour, this stage's and the next one's; what belongs to neither is
not for us, or not now, and the reason is told.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from flock_sim.core.kernel import FloatArray
from flock_sim.core.runge_kutta import STAGES
from flock_sim.core.stage_message import (
    HEADER,
    HEADER_AT,
    HEADER_END,
    stage_bytes,
    stage_header,
    stage_words,
)

FOREIGN = "of another run"
STRANGE = "not from a neighbour"
MISSHAPEN = "of a wrong length"
MALFORMED = "that can't be read"
STALE = "of an epoch that is over"
REPEATED = "for a stage already passed or out of reach"
IMPOSSIBLE = "with values that the sender can't have"

EARLY = 8
"""Messages of epochs that are still to begin that are kept, for each neighbour."""

REACH = 2**24
"""Epochs beyond the present one that are believed; those of a new clock begin with the seconds."""

NEVER = -1
"""Of no epoch: nothing has begun."""


class StageInbox:
    """The inbox of one bird. `heard` has shape (2, neighbours, words): even ticks and odd ones."""

    def __init__(self, neighbours: Sequence[int], members: int) -> None:
        """Be closed: stages come in once an epoch is open."""
        self.heard: FloatArray = np.zeros((2, len(neighbours), stage_words(members)))
        self.size = len(stage_bytes(np.zeros(stage_words(members)), members))
        # The headers of the messages that this stage still lacks, and the next one, each with the
        # neighbour and the room for it.
        self.lacking: dict[bytes, tuple[int, memoryview]] = {}
        self._next: dict[bytes, tuple[int, memoryview]] = {}
        self._early: dict[bytes, bytes] = {}
        self._slots = [
            [
                (other, stage_bytes(self.heard[side, k], members))
                for k, other in enumerate(neighbours)
            ]
            for side in range(2)
        ]
        self._neighbours = frozenset(neighbours)
        self._members = members
        self._run_id = 0
        self._epoch = NEVER
        self._tick = NEVER
        self._at_start = False

    def close(self, run_id: int, epoch: int) -> None:
        """Wait for `epoch` of the run to be opened: what comes for it is kept."""
        self._run_id, self._epoch = run_id, epoch
        self.lacking, self._next = {}, {}
        self._tick = NEVER

    def open(self, tick: int) -> None:
        """Begin the epoch at `tick` = 4 step + stage, and take what has come for it already.

        At the start of a flight, tick 0, all values are finite.
        """
        self._tick = tick
        self._at_start = tick == 0
        self.lacking, self._next = self._expected(tick), self._expected(tick + 1)
        for header in self.lacking.keys() & self._early.keys():
            self.take(self._early.pop(header))
        self._early = {
            header: data
            for header, data in self._early.items()
            if self._epoch_of(data) > self._epoch
        }

    def turn(self, tick: int) -> None:
        """Go on to `tick`, the next one: what has come for it is there."""
        self.lacking, self._next = self._next, self._expected(tick + 1)
        self._at_start = False

    def take(self, data: bytes) -> str:
        """Take a message as it came off the wire; return why it is ignored, or nothing."""
        if len(data) == self.size:
            header = data[HEADER_AT:HEADER_END]
            if self._at_start and header in self.lacking and not self._finite(data):
                return IMPOSSIBLE
            if slot := self.lacking.pop(header, None):
                slot[1][:] = data
                return ""
            if slot := self._next.pop(header, None):
                slot[1][:] = data
                return ""
        return self._refused(data)

    def _refused(self, data: bytes) -> str:
        """Return why a message is for neither slot; keep it where it is for later."""
        if len(data) != self.size:
            return MISSHAPEN
        run_id, _, epoch, bird, stage, members = stage_header(data)
        if run_id != self._run_id or self._epoch == NEVER:
            return FOREIGN
        if bird not in self._neighbours:
            return STRANGE
        if members != self._members:
            return MISSHAPEN
        if epoch < self._epoch:
            return STALE
        early = epoch > self._epoch or self._tick == NEVER
        header = data[HEADER_AT:HEADER_END]
        if not early or stage != 0 or epoch > self._epoch + REACH or header in self._early:
            return REPEATED
        if len(self._early) >= EARLY * len(self._neighbours):
            del self._early[next(iter(self._early))]
        self._early[header] = data
        return ""

    def _expected(self, tick: int) -> dict[bytes, tuple[int, memoryview]]:
        """Return the headers of all neighbours' messages of `tick`."""
        step, stage = divmod(tick, STAGES)
        run_id, epoch, members, pack = self._run_id, self._epoch, self._members, HEADER.pack
        return {
            pack(run_id, step, epoch, slot[0], stage, members): slot
            for slot in self._slots[tick & 1]
        }

    def _finite(self, data: bytes) -> bool:
        return bool(np.isfinite(np.frombuffer(data, offset=HEADER_END)).all())

    @staticmethod
    def _epoch_of(data: bytes) -> int:
        return stage_header(data)[2]
