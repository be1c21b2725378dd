# SPDX-License-Identifier: Apache-2.0
"""Many flocks integrated at once, without ROS and recording, to find those that hold together."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from threading import Event, Lock

import numpy as np

from flock_sim.analysis.metrics import STABLE_BELOW, speed_std
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.physics.arrays import FloatArray, IntArray
from flock_sim.reference.integrator import Reference
from flock_sim.theory.limit_search import NO_GAP
from flock_tools.experiments.workers import Workers

AT_ONCE = 1_000_000
"""Pair-steps between two checks of `halt`: some tenths of a second."""

ALIKE = 1e-9
"""Difference of opening speeds, in U_min, below which two gaps open equally fast."""

OnProgress = Callable[[int], None]


def opened_gaps(
    configuration: FlockConfiguration,
    span_ratio: FloatArray,
    halt: Event | None = None,
    on_progress: OnProgress | None = None,
) -> IntArray:
    """Fly an ensemble to t_max. Return 0 for a flock that holds together, else the gap that opens.

    A flock holds together by the paper's criterion: sigma_U < 1e-4 at t_max, undisturbed and over
    exact links, from the V of the homogeneous flock at U_0. The gap that opens (from 1) is the one
    whose birds differ most in speed, or NO_GAP if speeds are not finite. `span_ratio` has shape
    (birds, members), the result (members,). `on_progress` is called with the number of member-steps
    just taken. Once `halt` is set, the flight ends and the result has no meaning.
    """
    steps, members = configuration.steps, span_ratio.shape[1]
    flight = Reference(undisturbed(configuration), span_ratio)
    most = max(1, AT_ONCE // (max(1, len(flight.flock.pairs)) * members))
    while flight.step < steps and not (halt and halt.is_set()):
        count = min(most, steps - flight.step)
        flight.advance(count)
        if on_progress:
            on_progress(count * members)
    return gaps_at_end(flight.speed)


def undisturbed(configuration: FlockConfiguration) -> FlockConfiguration:
    """Return the paper's protocol for a flock: equal birds, no perturbations, exact links.

    States are recorded at the start and at the end.
    """
    return replace(
        configuration,
        record_every=configuration.steps,
        span_ratios=(),
        perturbations=(),
        links=(),
    )


def gaps_at_end(speed: FloatArray) -> IntArray:
    """Return the verdicts of `opened_gaps` from the speeds at t_max, shape (birds, members)."""
    with np.errstate(invalid="ignore", over="ignore"):
        apart = np.abs(np.diff(speed, axis=0))
        holds = speed_std(speed) < STABLE_BELOW
    most_apart = apart.max(axis=0, initial=0.0)
    first = np.argmax(apart >= most_apart - ALIKE, axis=0) + 1 if len(apart) else NO_GAP
    return np.where(holds, 0, np.where(np.isfinite(most_apart), first, NO_GAP))


@dataclass
class Ensembles:
    """Flies ensembles on all workers, and counts the member-steps."""

    configuration: FlockConfiguration
    workers: Workers
    on_progress: OnProgress = lambda member_steps: None
    """Called with the number of member-steps just taken."""
    member_steps: int = 0

    def opened_gaps(self, span_ratio: FloatArray) -> IntArray:
        """Do as the function `opened_gaps`. Each worker flies a part of the members."""
        halt, lock = Event(), Lock()

        def count_up(member_steps: int) -> None:
            with lock:
                self.member_steps += member_steps
                self.on_progress(member_steps)

        count = min(self.workers.count, span_ratio.shape[1])
        blocks = np.array_split(span_ratio, count, axis=1)
        # Neither can be sent to another machine.
        here = (halt, count_up) if self.workers.local else ()
        futures = [
            self.workers.executor.submit(opened_gaps, self.configuration, block, *here)
            for block in blocks
        ]
        try:
            gaps = np.concatenate([future.result() for future in futures])
        except BaseException:
            halt.set()
            for future in futures:
                future.cancel()
            raise
        if not self.workers.local:
            count_up(span_ratio.shape[1] * self.configuration.steps)
        return gaps
