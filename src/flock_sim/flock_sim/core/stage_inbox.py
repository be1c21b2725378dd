# SPDX-License-Identifier: Apache-2.0
"""Where the stage messages of a bird's neighbours arrive.

There are two slots for each neighbour, this exchange's and the next one's; what belongs to neither
is not for us, or not now, and the reason is told.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from flock_sim.core.kernel import FloatArray
from flock_sim.core.leg import Lacking
from flock_sim.core.links.timetable import Timetable
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
AGAIN = "that were heard before"
REPEATED = "for a stage already passed or out of reach"
IMPOSSIBLE = "with values that the sender can't have"

EARLY = 8
"""Messages of epochs that are still to begin that are kept, for each neighbour."""

REACH = 2**24
"""Epochs beyond the present one that are believed; those of a new clock begin with the seconds."""

NEVER = -1
"""Of no epoch: nothing has begun."""


class StageInbox:
    """The inbox of one bird. `heard` has shape (2, neighbours, words): one exchange and the next.

    Where there is one at every tick, the first is that of even ticks.
    """

    def __init__(
        self,
        neighbours: Sequence[int],
        members: int,
        timetable: Timetable | None = None,
        run_id: int = 0,
    ) -> None:
        """Be closed: stages come in once an epoch is open. `run_id` 0: not known yet."""
        self._timetable = timetable or Timetable()
        self.every_tick = self._timetable.every_tick
        """Whether stages are exchanged at every tick."""
        self.side = 0
        """The place in `heard` of this exchange; between two, of the one before."""
        self.heard: FloatArray = np.zeros((2, len(neighbours), stage_words(members)))
        self.size = len(stage_bytes(np.zeros(stage_words(members)), members))
        # The headers of the messages that this stage still lacks, and the next one, each with the
        # neighbour that it is of.
        self.lacking: dict[bytes, int] = {}
        self._next: dict[bytes, int] = {}
        self._early: dict[int, dict[bytes, bytes]] = {other: {} for other in neighbours}
        self._room = [
            {other: stage_bytes(self.heard[side, k], members) for k, other in enumerate(neighbours)}
            for side in range(2)
        ]
        self._neighbours = tuple(neighbours)
        self._members = members
        self._run_id = run_id
        self._epoch = NEVER
        self._tick = NEVER  # of this exchange; between two, of the one before
        self._at_start = False

    def close(self, run_id: int, epoch: int) -> None:
        """Wait for `epoch` of the run to be opened: what comes for it is kept."""
        self._run_id, self._epoch = run_id, epoch
        self.lacking, self._next = {}, {}
        self._tick = NEVER
        self._forget_early(epoch - 1)

    def open(self, tick: int) -> bool:
        """Begin the epoch at `tick` = 4 step + stage, and take what has come for it already.

        At the start of a flight, tick 0, all values are finite. Returns whether there is an
        exchange at `tick`.
        """
        self._tick = tick
        self._at_start = tick == 0
        self.side = tick & 1
        due = self._timetable.due(tick)
        self.lacking = self._expected(tick) if due else {}
        self._next = self._expected(self._timetable.after(tick))
        for early in self._early.values():
            for header in (self.lacking | self._next).keys() & early.keys():
                self.take(early[header])
        self._forget_early(self._epoch)
        return due

    def turn(self, tick: int) -> bool:
        """Go on to `tick`, the next one: what has come for it is there.

        Returns whether there is an exchange; where there is none, nothing is lacking.
        """
        self._at_start = False
        following = tick + 1
        if not self.every_tick:
            if not self._timetable.due(tick):
                return False
            following = self._timetable.after(tick)
        self._tick = tick
        self.lacking = self._next
        self._next = self._expected(following)
        self.side = 1 - self.side
        return True

    @property
    def lacking_by_side(self) -> Lacking:
        """The neighbours whose messages are not here, at each side of `heard`."""
        now, following = set(self.lacking.values()), set(self._next.values())
        return (following, now) if self.side else (now, following)

    def go_to(self, tick: int, lacking: Lacking) -> None:
        """Be at `tick` of this epoch, without what is `lacking`; exchanges are at every tick."""
        self._at_start &= tick == self._tick
        self._tick = tick
        self.side = tick & 1
        self.lacking, self._next = (
            {header: bird for header, bird in self._expected(at).items() if bird in lacking[at & 1]}
            for at in (tick, tick + 1)
        )

    def take(self, data: bytes) -> str:
        """Take a message as it came off the wire; return why it is ignored, or nothing."""
        if len(data) == self.size:
            header = data[HEADER_AT:HEADER_END]
            if bird := self.lacking.get(header):
                if self._at_start and not self._finite(data):
                    return IMPOSSIBLE
                del self.lacking[header]
                self._room[self.side][bird][:] = data
                return ""
            if bird := self._next.pop(header, 0):
                self._room[1 - self.side][bird][:] = data
                return ""
        return self._refused(data)

    def _refused(self, data: bytes) -> str:
        """Return why a message is for neither slot; keep it where it is for later."""
        if len(data) != self.size:
            return MISSHAPEN
        run_id, step, epoch, bird, stage, members = stage_header(data)
        if run_id == 0 or self._run_id not in (0, run_id):
            return FOREIGN
        if bird not in self._neighbours:
            return STRANGE
        if members != self._members:
            return MISSHAPEN
        if epoch < self._epoch:
            return STALE
        early = epoch > self._epoch or self._tick == NEVER
        if not early and self._may_come_again(STAGES * step + stage):
            return AGAIN
        believed = self._epoch == NEVER or epoch <= self._epoch + REACH
        header, kept = data[HEADER_AT:HEADER_END], self._early[bird]
        if header in kept:
            return AGAIN
        if not early or stage != 0 or not believed:
            return REPEATED
        if step == 0 and not self._finite(data):
            return IMPOSSIBLE
        kept[header] = data
        if len(kept) <= EARLY:
            return ""
        del kept[next(iter(kept))]  # the oldest, which now is the one that is ignored
        return REPEATED

    def _may_come_again(self, tick: int) -> bool:
        """Whether `tick` is one of the last two exchanges of a neighbour, who is near ours."""
        due, after = self._timetable.due, self._timetable.after
        return due(tick) and tick <= after(self._tick) and self._tick <= after(after(tick))

    def _forget_early(self, epoch: int) -> None:
        """Forget what is kept of other runs, and of epochs up to `epoch`."""
        for other, kept in self._early.items():
            self._early[other] = {
                header: data
                for header, data in kept.items()
                if self._run_of(data) == self._run_id and self._epoch_of(data) > epoch
            }

    def _expected(self, tick: int) -> dict[bytes, int]:
        """Return the headers of all neighbours' messages of `tick`, each with its neighbour."""
        step, stage = divmod(tick, STAGES)
        run_id, epoch, members, pack = self._run_id, self._epoch, self._members, HEADER.pack
        headers = {}  # in a loop, which is faster for a few than a comprehension
        for bird in self._neighbours:
            headers[pack(run_id, step, epoch, bird, stage, members)] = bird
        return headers

    def _finite(self, data: bytes) -> bool:
        return bool(np.isfinite(np.frombuffer(data, offset=HEADER_END)).all())

    @staticmethod
    def _run_of(data: bytes) -> int:
        return stage_header(data)[0]

    @staticmethod
    def _epoch_of(data: bytes) -> int:
        return stage_header(data)[2]
