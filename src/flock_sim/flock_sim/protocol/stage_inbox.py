# SPDX-License-Identifier: Apache-2.0
"""The inbox for the stage messages of a bird's neighbours.

Each neighbour has two slots: one for this exchange and one for the next. A message for neither slot
is ignored, with a reason, or kept for a later epoch.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from flock_sim.links.exchange_schedule import ExchangeSchedule
from flock_sim.messages.epochs import NEVER, REACH, ahead, before
from flock_sim.messages.rejection import (
    AGAIN,
    FOREIGN,
    IMPOSSIBLE,
    MALFORMED,
    MISSHAPEN,
    REPEATED,
    STALE,
    STRANGE,
)
from flock_sim.messages.stage_layout import (
    BEFORE,
    HEADER_AT,
    HEADER_END,
    WORD,
    has_layout,
    stage_words,
)
from flock_sim.messages.types import Stage
from flock_sim.physics.arrays import FloatArray, IntArray
from flock_sim.physics.runge_kutta import STAGES
from flock_sim.protocol.stage_words import (
    ANY,
    BIRD,
    BROKEN,
    EACH,
    EPOCH,
    EXCHANGE,
    FIRST,
    HEARD,
    HERE,
    LACKING,
    MEMBERS,
    NAME,
    NEIGHBOURS,
    NOT_AWAITED,
    NOT_FINITE,
    RUN_ID,
    SIDE,
    SIZE,
    TAKEN,
    TICK,
    accept,
    begin_epoch,
    close,
    turn,
)

EARLY = 8
"""Most messages of later epochs kept per neighbour."""


class StageInbox:
    """The inbox of one bird. `heard` has shape (2, neighbours, words): one exchange and the next.

    If every tick has an exchange, index 0 is that of even ticks.
    """

    def __init__(
        self,
        neighbours: Sequence[int],
        members: int,
        exchange_schedule: ExchangeSchedule | None = None,
        run_id: int = 0,
        bird: int = 0,
    ) -> None:
        """Make the inbox of `bird`, closed: no stages are taken before `open`.

        `run_id` 0: not known yet.
        """
        self._exchange_schedule = exchange_schedule or ExchangeSchedule()
        self.every_tick = self._exchange_schedule.every_tick
        """Whether stages are exchanged at every tick."""
        self.heard: FloatArray = np.zeros((2, len(neighbours), stage_words(members)))
        self.words: IntArray = np.zeros(FIRST + EACH * len(neighbours), np.int64)
        """The words of the bird; see `protocol/stage_words.py`."""
        self.word = self.words.data
        """The same memory, whose items are faster to read from Python."""
        size = WORD * stage_words(members) - BEFORE
        self.words[BIRD : NEIGHBOURS + 1] = bird, members, size, len(neighbours)
        self.words[FIRST + NAME :: EACH] = neighbours
        self.words[HEARD] = self.heard.ctypes.data
        room = np.zeros(size, np.uint8)
        self._incoming, self._address = room.data, room.ctypes.data  # of the message being checked
        self._early: dict[int, dict[bytes, bytes]] = {other: {} for other in neighbours}
        self._neighbours = tuple(neighbours)
        self.close(run_id, NEVER)

    @property
    def side(self) -> int:
        """The index in `heard` of this exchange; between two exchanges, of the last one."""
        return self.word[SIDE]

    @property
    def complete(self) -> bool:
        """Whether all messages of this exchange are here."""
        return not self.word[LACKING + self.word[SIDE]]

    @property
    def lacking(self) -> list[int]:
        """The neighbours whose messages of this exchange have not arrived."""
        here = self.words[FIRST + HERE + self.side :: EACH]
        return [other for other, came in zip(self._neighbours, here, strict=True) if not came]

    def close(self, run_id: int, epoch: int) -> None:
        """Close until `epoch` of the run is opened; keep the messages that arrive for it."""
        self._run_id, self._epoch = run_id, epoch
        self.word[RUN_ID] = run_id - (run_id >> 63 << 64)  # the same bits, with a sign
        self.word[EPOCH] = epoch
        close(self.words)
        if epoch != NEVER:
            self._forget_early(before(epoch))

    def open(self, tick: int) -> bool:
        """Begin the epoch at `tick` = 4 step + stage, and take the messages kept for it.

        At the start of a flight, tick 0, messages with values that are not finite are refused.
        Returns whether `tick` has an exchange.
        """
        due, following = self._exchange_schedule.due(tick), self._exchange_schedule.after(tick)
        begin_epoch(self.words, tick, due, following)
        for early in self._early.values():
            for data in early.values():
                self._accept(data)
        self._forget_early(self._epoch)
        return due

    def turn(self) -> bool:
        """Go to the next tick; its messages that have already arrived are kept.

        Returns whether that tick has an exchange. If it has none, no message is lacking.
        """
        tick = self.word[TICK] = self.word[TICK] + 1
        due = self.every_tick or self._exchange_schedule.due(tick)
        if due:
            turn(self.words, self._exchange_schedule.after(tick))
        return due

    def take(self, data: bytes) -> str:
        """Take a message in serialised form; return why it is ignored, or ""."""
        outcome = self._accept(data)
        if outcome in (NOT_FINITE, BROKEN):
            return IMPOSSIBLE if outcome == NOT_FINITE else MALFORMED
        return "" if outcome == TAKEN else self._refused(data)

    def _accept(self, data: bytes) -> int:
        size = len(data)
        if size != self.word[SIZE]:
            return NOT_AWAITED
        self._incoming[:] = data
        return accept(self.words, ANY, self._address, size)

    def _refused(self, data: bytes) -> str:
        """Return why a message is for neither slot; keep it if it is for a later epoch."""
        if len(data) != self.word[SIZE]:
            return MISSHAPEN
        run_id, step, epoch, bird, stage, members = Stage.header(data)
        if run_id == 0 or self._run_id not in (0, run_id):
            return FOREIGN
        if bird not in self._neighbours:
            return STRANGE
        if members != self.word[MEMBERS]:
            return MISSHAPEN
        if not has_layout(data, members):
            return MALFORMED
        later = ahead(epoch, self._epoch)
        if later < 0:
            return STALE
        early = later > 0 or self.word[EXCHANGE] == NEVER
        if not early and self._may_come_again(STAGES * step + stage):
            return AGAIN
        believed = later <= REACH
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
        del kept[next(iter(kept))]  # the oldest, which is ignored instead
        return REPEATED

    def _may_come_again(self, tick: int) -> bool:
        """Whether `tick` may be one of a neighbour's last two exchanges, which it may repeat."""
        due, after, now = (
            self._exchange_schedule.due,
            self._exchange_schedule.after,
            self.word[EXCHANGE],
        )
        return due(tick) and tick <= after(now) and now <= after(after(tick))

    def _forget_early(self, epoch: int) -> None:
        """Drop the kept messages of other runs, and of epochs up to `epoch`."""
        for other, kept in self._early.items():
            self._early[other] = {
                header: data
                for header, data in kept.items()
                if self._run_of(data) == self._run_id and ahead(self._epoch_of(data), epoch) > 0
            }

    def _finite(self, data: bytes) -> bool:
        return bool(np.isfinite(np.frombuffer(data, offset=HEADER_END)).all())

    @staticmethod
    def _run_of(data: bytes) -> int:
        return Stage.header(data)[0]

    @staticmethod
    def _epoch_of(data: bytes) -> int:
        return Stage.header(data)[2]
