# SPDX-License-Identifier: Apache-2.0
"""The stability diagram from one flight over ROS 2, whose members are all flocks to be tried."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from flock_sim.configuration import span_ratios
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.errors import RunFailed
from flock_sim.launcher.flight import Plan, begin_bag, fly, on_ros
from flock_sim.physics.arrays import FloatArray, IntArray
from flock_sim.recording.output_directory import own_output
from flock_sim.recording.run import Run
from flock_sim.theory.limit_search import Limits
from flock_sim.theory.span_limits import search
from flock_tools.experiments.ensemble import gaps_at_end, undisturbed
from flock_tools.experiments.sweep.members import record_every

MOST_RECORDS = 20
"""Largest number of recorded rows after the start. Only the last one is read."""


@dataclass(frozen=True)
class HowFlown:
    """Options of the flight; none of them changes a verdict."""

    processes: int
    """Number of processes for the birds."""
    timeout: float
    """Longest standstill before giving up, in s."""
    bag: Path | None
    """Directory of the bag; None: it is not kept."""


def flown_limits(
    configuration: FlockConfiguration,
    birds: Sequence[int],
    low: float,
    high: float,
    points: int,
    how: HowFlown,
) -> tuple[list[Limits], dict[str, Any]]:
    """Return the limits of each of `birds` by one flight, and facts of that flight.

    Each member has one of `birds` modified, to one of `points` span ratios from `low` to `high` or
    to its own. No other ratios are tried. Raises RunFailed if the flight can't be finished.
    """
    trial = _FlightTrial(configuration, how)
    found = search(configuration, birds, low, high, math.inf, trial.opened_gaps, grid=points - 1)
    return found, {
        "as_given": trial.as_given,
        "resolution": (high - low) / (points - 1),
        "dt": configuration.dt,
        "t_max": configuration.t_max,
        "processes": how.processes,
        **trial.facts,
        "bag": None if how.bag is None else str(how.bag),
    }


@dataclass
class _FlightTrial:
    """Tries span ratios in a single flight."""

    configuration: FlockConfiguration
    how: HowFlown
    as_given: bool = False
    """Whether the flock of the configuration, which is always a member, holds together."""
    facts: dict[str, Any] = field(default_factory=dict)

    def opened_gaps(self, span_ratio: FloatArray) -> IntArray:
        """Do as `ensemble.opened_gaps`, over ROS."""
        given = self.configuration.span_ratio
        fleet = span_ratio
        if not np.all(fleet == given, axis=0).any():
            fleet = np.hstack([fleet, given])
        with TemporaryDirectory(prefix="flock-limits-") as directory:
            gaps = gaps_at_end(self._speeds_at_end(fleet, Path(directory)))
        self.as_given = bool(gaps[np.all(fleet == given, axis=0)][0] == 0)
        return gaps[: span_ratio.shape[1]]

    def _speeds_at_end(self, span_ratio: FloatArray, directory: Path) -> FloatArray:
        """Fly to t_max. Return the speeds there, shape (birds, members)."""
        flown = replace(
            undisturbed(self.configuration),
            record_every=record_every(self.configuration.steps, MOST_RECORDS),
            span_ratios=span_ratios.entries(span_ratio),
        )
        bag = self.how.bag or directory / "bag"
        begun = time.monotonic()
        plan = Plan(flown, bag, self.how.processes, self.how.timeout, begun)
        with on_ros(), own_output(bag, force=False) as output:
            begin_bag(output, plan)
            flight = fly(plan)
            output.check()
        seconds = time.monotonic() - begun
        member_steps = flown.members * flown.steps
        self.facts = {
            "members": flown.members,
            "seconds": seconds,
            "start_seconds": flight["start_seconds"],
            "member_steps": member_steps,
            "member_steps_per_second": member_steps / seconds,
            **dict.fromkeys(("kernel_share", "message_share", "waiting_share")),  # not measured
        }
        with Run(bag) as run:
            if run.missing:
                raise RunFailed(f"{run.missing}: limits need the end of the flight; fly again")
            return run.at(flown.t_max).speed
