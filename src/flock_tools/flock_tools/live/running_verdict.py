# SPDX-License-Identifier: Apache-2.0
"""The verdict on a flight that is still observed, from the states that were seen so far."""

from __future__ import annotations

import numpy as np

from flock_sim.analysis.verdict import STALLED, flies, judge, shortest_time
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.physics.scaling import Scales
from flock_tools.live.flock_monitor import Sample

MOST_ROWS = 400
"""Largest number of samples that are kept. Beyond it, every second one is dropped."""

SPACED = 0.75
"""Shortest time to the next sample that is kept, over the mean time between the kept ones."""


class RunningVerdict:
    """Collects samples of one member, and judges the flight as if it had begun with the first."""

    def __init__(self) -> None:
        """Start without samples."""
        self._flock: tuple[object, ...] = ()
        self._rows: list[Sample] = []
        self._shortest_gap = 0.0  # between kept samples, in b / U_min

    def see(self, sample: Sample) -> None:
        """Take the latest sample. Another flock or member, or an earlier step, starts anew."""
        flock = (sample.birds, sample.members, sample.member, sample.coupling, sample.end)
        rows = self._rows
        if flock != self._flock or (rows and sample.step < rows[-1].step):
            self._flock, self._shortest_gap = flock, 0.0
            rows.clear()
        if rows and sample.time - rows[-1].time <= self._shortest_gap:
            return
        rows.append(sample)
        if len(rows) > MOST_ROWS:
            del rows[1::2]
            spacing = (rows[-1].time - rows[0].time) / (len(rows) - 1)
            self._shortest_gap = SPACED * spacing

    def told(self, configuration: FlockConfiguration | None) -> str:
        """Return the verdict with its reason, and the time since which it was observed.

        Without a configuration, which gives the scales of the bird, it is empty.
        """
        if configuration is None or not self._rows:
            return ""
        since = self._rows[0].time
        time = np.array([sample.time for sample in self._rows])
        position = np.array([sample.position for sample in self._rows])
        last = self._rows[-1]
        flying = flies(position[-1], np.array(last.speed))
        if not flying.all():
            return f"{STALLED}: the speed of bird {int(np.argmin(flying)) + 1} is not above 0"
        ((word, reason),) = judge(
            time, position[:, :, np.newaxis], since, shortest_time(Scales.of(configuration))
        )
        return f"{word} since t = {since:g}: {reason}"
