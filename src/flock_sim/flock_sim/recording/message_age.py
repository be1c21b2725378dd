# SPDX-License-Identifier: Apache-2.0
"""The evaluation of a free flight: the ages of the used messages, and their effect."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from flock_sim.analysis.metrics import plain
from flock_sim.physics import formation
from flock_sim.physics.arrays import FloatArray
from flock_sim.recording.run import Run


@dataclass(frozen=True)
class Spread:
    """The distribution of values: median, 95th percentile and largest value."""

    median: float
    p95: float
    max: float

    @classmethod
    def of(cls, values: FloatArray, largest: FloatArray) -> Spread:
        """Return the distribution of `values`; `largest` has the largest values between them."""
        median, p95 = np.quantile(values, (0.5, 0.95)).tolist()
        return cls(median, p95, float(np.max(largest)))

    def times(self, unit: float) -> Spread:
        """Return the distribution in another unit."""
        return Spread(unit * self.median, unit * self.p95, unit * self.max)


@dataclass(frozen=True)
class MessageAge:
    """The ages of the birds' data on their neighbours in a free flight, and late steps."""

    factor: float
    """Real-time factor of the flight."""
    unit: float
    """b / U_min in s of real time, at this factor."""
    links: dict[tuple[int, int], Spread]
    """The ages in s of real time, by (source, target)."""
    age: Spread | None
    """The ages of all links, in s of real time; None if no bird has a neighbour."""
    behind: Spread | None
    """Number of steps by which the used states lag the recorded steps in which they were used."""
    taken: int
    """Number of steps that all birds took, up to the last recorded one."""
    late: list[int]
    """For each bird, the number of steps that it took when the next step was already due."""
    lateness: float
    """Largest delay of a step after its due time, in s."""

    def as_json(self) -> dict[str, Any]:
        """Return the JSON output of `metrics`. Ages are in b / U_min, except `age_seconds`."""
        perhaps = self.age.times(1.0 / self.unit) if self.age else None
        return {
            "mode": "free",
            "real_time_factor": self.factor,
            "age": vars(perhaps) if perhaps else None,
            "age_seconds": vars(self.age) if self.age else None,
            "steps_behind": vars(self.behind) if self.behind else None,
            "links": [
                {"source": source, "target": target, **vars(spread.times(1.0 / self.unit))}
                for (source, target), spread in self.links.items()
            ],
            "steps_taken": self.taken,
            "late_steps": self.late,
            "lateness_seconds": self.lateness,
        }

    def told(self) -> list[str]:
        """Return the lines that `fly` and `metrics` print."""
        lines = [f"flown freely, at real-time factor {self.factor:g}"]
        if self.age and self.behind:
            age, behind = self.age.times(1.0 / self.unit), self.behind
            lines += [
                f"  age of what is known median {age.median:.3g}, 95 % below {age.p95:.3g}, at "
                f"most {age.max:.3g} b/U_min",
                f"  in real time         median {1e3 * self.age.median:.3g}, 95 % below "
                f"{1e3 * self.age.p95:.3g}, at most {1e3 * self.age.max:.3g} ms",
                f"  steps behind         median {behind.median:g}, 95 % at most {behind.p95:g}, "
                f"at most {behind.max:g}; at recorded steps",
            ]
        lines.append(
            f"  late steps           {sum(self.late)} of {self.taken}, by "
            f"{1e3 * self.lateness:.3g} ms at most"
        )
        return lines


def freshness(run: Run) -> MessageAge | None:
    """Return the ages of the used messages in `run`; None if it was not flown freely.

    The largest age is that of all steps. The distribution, and all numbers of steps behind, are
    those of the recorded steps.
    """
    factor, flown = run.real_time_factor, run.configuration
    if not factor:
        return None
    told: dict[int, list[FloatArray]] = {bird: [] for bird in range(1, flown.birds + 1)}
    taken, late, lateness = [0] * flown.birds, [0] * flown.birds, 0.0
    for bird, ages in run.ages():
        told[bird].append(np.stack([ages.age, ages.age_max, ages.behind]))
        taken[bird - 1], late[bird - 1] = ages.step + 1, ages.late
        lateness = max(lateness, ages.lateness)
    links, every = {}, []
    for bird, rows in told.items():
        values = np.stack(rows) if rows else np.empty((0, 3, 0))
        for k, other in enumerate(formation.neighbours(bird, flown.birds, flown.coupling)):
            if len(values):
                links[other, bird] = Spread.of(values[:, 0, k], values[:, 1, k])
                every.append(values[:, :, k])
    age = behind = None
    if every:
        all_values = np.concatenate(every)
        age = Spread.of(all_values[:, 0], all_values[:, 1])
        behind = Spread.of(all_values[:, 2], all_values[:, 2])
    return MessageAge(factor, flown.second / factor, links, age, behind, sum(taken), late, lateness)


@dataclass(frozen=True)
class Deviation:
    """The deviation of a flight from another: arrays of shape (quantities, members), as in UNITS.

    They are the largest differences of any bird, at the last recorded step and at any step.
    """

    end: FloatArray
    most: FloatArray

    def as_json(self) -> dict[str, object]:
        """Return the deviation by quantity, with None for values that are not finite."""
        return {
            name: {"end": plain(self.end[k]), "max": plain(self.most[k])}
            for k, name in enumerate(UNITS)
        }

    def told(self) -> list[str]:
        """Return the lines that `metrics` prints: the largest of all members."""
        return ["off the same flight in lockstep"] + [
            f"  {name:<20} {np.max(self.end[k]):.3g} {unit} at the end, "
            f"{np.max(self.most[k]):.3g} at most"
            for k, (name, unit) in enumerate(UNITS.items())
        ]


UNITS = {"position": "b", "spacing": "b", "speed": "U_min"}
"""The compared quantities and their units."""


def deviation(run: Run, show: Callable[[int], None]) -> Deviation:
    """Return the deviation of `run` from its lockstep flight; `show` is called with each step."""
    from flock_sim.reference.integrator import Reference  # with numba

    flown = run.configuration
    end = np.zeros((len(UNITS), flown.members))
    most = end
    lockstep = Reference(flown, live=run.perturbations()).fly()
    for snapshot, exact in zip(run.snapshots(), lockstep, strict=False):
        position, speed = snapshot.position - exact.position, snapshot.speed - exact.speed
        off = (position, np.diff(position, axis=0), speed)
        end = np.stack([np.max(np.abs(values), axis=0, initial=0.0) for values in off])
        most = np.maximum(most, end)
        show(snapshot.step)
    return Deviation(end, most)
