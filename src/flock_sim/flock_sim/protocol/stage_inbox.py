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
    MISSHAPEN,
    REPEATED,
    STALE,
    STRANGE,
)
from flock_sim.messages.stage_layout import (
    HEADER,
    HEADER_AT,
    HEADER_END,
    stage_bytes,
    stage_header,
    stage_words,
)
from flock_sim.physics.arrays import FloatArray
from flock_sim.physics.runge_kutta import STAGES
from flock_sim.protocol.fast_path import Lacking

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
    ) -> None:
        """Start closed: no stages are taken before `open`. `run_id` 0: not known yet."""
        self._exchange_schedule = exchange_schedule or ExchangeSchedule()
        self.every_tick = self._exchange_schedule.every_tick
        """Whether stages are exchanged at every tick."""
        self.side = 0
        """The index in `heard` of this exchange; between two exchanges, of the last one."""
        self.heard: FloatArray = np.zeros((2, len(neighbours), stage_words(members)))
        self.size = len(stage_bytes(np.zeros(stage_words(members)), members))
        # The headers of the messages that this exchange and the next one lack, each with its
        # neighbour.
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
        self._tick = NEVER  # of this exchange; between two exchanges, of the last one
        self._at_start = False

    def close(self, run_id: int, epoch: int) -> None:
        """Close until `epoch` of the run is opened; keep the messages that arrive for it."""
        self._run_id, self._epoch = run_id, epoch
        self.lacking, self._next = {}, {}
        self._tick = NEVER
        self._forget_early(before(epoch))

    def open(self, tick: int) -> bool:
        """Begin the epoch at `tick` = 4 step + stage, and take the messages kept for it.

        At the start of a flight, tick 0, messages with values that are not finite are refused.
        Returns whether `tick` has an exchange.
        """
        self._tick = tick
        self._at_start = tick == 0
        self.side = tick & 1
        due = self._exchange_schedule.due(tick)
        self.lacking = self._expected(tick) if due else {}
        self._next = self._expected(self._exchange_schedule.after(tick))
        for early in self._early.values():
            for header in (self.lacking | self._next).keys() & early.keys():
                self.take(early[header])
        self._forget_early(self._epoch)
        return due

    def turn(self, tick: int) -> bool:
        """Go to `tick`, the next one; its messages that have already arrived are kept.

        Returns whether `tick` has an exchange. If it has none, no message is lacking.
        """
        self._at_start = False
        following = tick + 1
        if not self.every_tick:
            if not self._exchange_schedule.due(tick):
                return False
            following = self._exchange_schedule.after(tick)
        self._tick = tick
        self.lacking = self._next
        self._next = self._expected(following)
        self.side = 1 - self.side
        return True

    @property
    def lacking_by_side(self) -> Lacking:
        """The neighbours whose messages have not arrived, for each side of `heard`."""
        now, following = set(self.lacking.values()), set(self._next.values())
        return (following, now) if self.side else (now, following)

    def go_to(self, tick: int, lacking: Lacking) -> None:
        """Go to `tick` of this epoch, with messages `lacking`; every tick has an exchange."""
        self._at_start &= tick == self._tick
        self._tick = tick
        self.side = tick & 1
        self.lacking, self._next = (
            {header: bird for header, bird in self._expected(at).items() if bird in lacking[at & 1]}
            for at in (tick, tick + 1)
        )

    def take(self, data: bytes) -> str:
        """Take a message in serialised form; return why it is ignored, or ""."""
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
        """Return why a message is for neither slot; keep it if it is for a later epoch."""
        if len(data) != self.size:
            return MISSHAPEN
        run_id, step, epoch, bird, stage, members = stage_header(data)
        if run_id == 0 or self._run_id not in (0, run_id):
            return FOREIGN
        if bird not in self._neighbours:
            return STRANGE
        if members != self._members:
            return MISSHAPEN
        later = ahead(epoch, self._epoch)
        if later < 0:
            return STALE
        early = later > 0 or self._tick == NEVER
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
        due, after = self._exchange_schedule.due, self._exchange_schedule.after
        return due(tick) and tick <= after(self._tick) and self._tick <= after(after(tick))

    def _forget_early(self, epoch: int) -> None:
        """Drop the kept messages of other runs, and of epochs up to `epoch`."""
        for other, kept in self._early.items():
            self._early[other] = {
                header: data
                for header, data in kept.items()
                if self._run_of(data) == self._run_id and ahead(self._epoch_of(data), epoch) > 0
            }

    def _expected(self, tick: int) -> dict[bytes, int]:
        """Return the headers of all neighbours' messages of `tick`, each with its neighbour."""
        step, stage = divmod(tick, STAGES)
        run_id, epoch, members, pack = self._run_id, self._epoch, self._members, HEADER.pack
        headers = {}  # for few neighbours a loop is faster than a comprehension
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
