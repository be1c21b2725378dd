# SPDX-License-Identifier: Apache-2.0
"""When the birds of a flock exchange messages."""

from __future__ import annotations

from dataclasses import dataclass

from flock_sim.physics.runge_kutta import STAGES


@dataclass(frozen=True)
class ExchangeSchedule:
    """The ticks, 4 step + stage, at which every bird sends its values and waits for the others'.

    The whole flock has one schedule. So neighbours are never more than one exchange apart, whatever
    their links are, and two slots hold all messages that can arrive.
    """

    every_tick: bool = True
    intervals: tuple[int, ...] = ()
    """Otherwise, exchanges are at stage 0 of the steps that are multiples of one of these."""

    def due(self, tick: int) -> bool:
        """Whether there is an exchange at `tick`."""
        if self.every_tick:
            return True
        step, stage = divmod(tick, STAGES)
        return stage == 0 and any(step % interval == 0 for interval in self.intervals)

    def after(self, tick: int) -> int:
        """Return the tick of the first exchange after `tick`."""
        if self.every_tick:
            return tick + 1
        step = tick // STAGES  # the step of the last stage 0 at or before `tick`
        return STAGES * min((step // interval + 1) * interval for interval in self.intervals)

    def exchanges(self, first: int, until: int) -> int:
        """Return how many exchanges there are in the steps from `first` to below `until`."""
        if self.every_tick:
            return STAGES * (until - first)
        return sum(self.due(STAGES * step) for step in range(first, until))
