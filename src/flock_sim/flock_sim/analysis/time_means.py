# SPDX-License-Identifier: Apache-2.0
"""Means over time and over the birds of a flock.

Each recorded state has the means over all steps since the record before it. So the means of a
flight do not depend on which steps were recorded, as those of the values at recorded times do.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flock_sim.analysis.metrics import mean_over_birds, plain
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.errors import FlockError
from flock_sim.physics.arrays import FloatArray, IntArray
from flock_sim.physics.scaling import Scales, drag_reduction

SHARE = 0.1
"""The part of a flight, at its end, that the means are over if no other time is asked for."""


@dataclass(frozen=True)
class TimeMeans:
    """Means over time; nan if the bag was recorded by a version that did not record them."""

    averaged_from: float
    """Time of the step before the first one that the means are over, in b / U_min."""
    until: float
    """Time of the last step that they are over, in b / U_min."""
    time_mean_speed: FloatArray
    """Shape (members,), in U_min."""
    time_mean_drag_reduction: FloatArray
    """eta, shape (members,)."""
    time_mean_drag_reduction_of_birds: FloatArray
    """eta_i, shape (members, birds)."""

    @property
    def recorded(self) -> bool:
        """Whether the bag has means. A member that diverged has none either."""
        return bool(np.isfinite(self.time_mean_speed).any())

    def as_json(self) -> dict[str, object]:
        """Return plain lists and numbers, with None for values that are not known."""
        return {name: plain(value) for name, value in vars(self).items() if name != "until"}


class Averaging:
    """Collects the recorded means from which the means over a longer time follow."""

    def __init__(self, configuration: FlockConfiguration, until: float, over: float | None) -> None:
        """Average over the time `over`, in b / U_min, up to `until`, both in b / U_min.

        None is SHARE of the time up to `until`. At least the means of one record are used. Raises
        FlockError if `over` is not above 0, or if `until` is not a time of the flight.
        """
        if over is not None and not 0.0 < over < np.inf:
            raise FlockError(f"averaging over {over:g}: must be a finite time above 0")
        t_max, dt = configuration.t_max, configuration.dt
        if not 0.0 <= until < t_max + dt:  # the time that a damaged state states, for example
            raise FlockError(f"averaging up to time {until:g}: must be 0 to t_max = {t_max:g}")
        self._configuration = configuration
        span = SHARE * until if over is None else over
        every = configuration.record_every
        self.last = round(until / dt)
        """The last recorded step that is used."""
        records = max(1, round(span / (every * dt)))
        self.first = max(0, self.last - every * (records - 1))
        """The first recorded step that is used."""
        shape = configuration.birds, configuration.members
        self._speed, self._drag = np.zeros(shape), np.zeros(shape)
        self._weight = np.zeros((configuration.birds, 1))

    def add(self, bird: IntArray, step: IntArray, means: FloatArray) -> None:
        """Add states of birds, indices from 0, at steps; `means` has shape (states, 2, members).

        States outside of the time are ignored.
        """
        due = (step >= self.first) & (step <= self.last)
        bird, step, means = bird[due], step[due], means[due]
        weight = np.where(step > 0, self._configuration.record_every, 1)[:, np.newaxis]
        with np.errstate(invalid="ignore", over="ignore"):
            np.add.at(self._speed, bird, weight * means[:, 0])
            np.add.at(self._drag, bird, weight * means[:, 1])
        np.add.at(self._weight, bird, weight)

    def result(self) -> TimeMeans:
        """Return the means of all states that were added."""
        configuration = self._configuration
        with np.errstate(invalid="ignore", divide="ignore"):
            speed, drag = self._speed / self._weight, self._drag / self._weight
            saved = drag_reduction(drag, Scales.of(configuration).cruise_drag)
            begin = max(0, self.first - configuration.steps_averaged(self.first))
            return TimeMeans(
                configuration.time(begin),
                configuration.time(self.last),
                mean_over_birds(speed),
                mean_over_birds(saved),
                saved.T,
            )
