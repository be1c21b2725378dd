# SPDX-License-Identifier: Apache-2.0
"""The verdict on a whole flight, from a bounded number of its recorded steps."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from flock_sim.analysis.verdict import (
    Stall,
    Verdicts,
    collected,
    evenly,
    first_stalled,
    flies,
    judge,
    shortest_time,
)
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.configuration.perturbation import Perturbation
from flock_sim.errors import FlockError
from flock_sim.physics.arrays import BoolArray, FloatArray
from flock_sim.physics.flock_state import FlockState
from flock_sim.physics.scaling import Scales


class Recorded(Protocol):
    """Recorded states of a flight: a Run, or states in memory."""

    configuration: FlockConfiguration

    def snapshots(self) -> Iterator[FlockState]:
        """Yield all recorded states in order."""

    def snapshots_at(self, steps: Sequence[int]) -> Iterator[FlockState]:
        """Yield the states at those of `steps`, in ascending order, that are recorded."""


@dataclass
class Flown:
    """A flight in memory: all its recorded states, in order.

    flown = Flown(configuration, list(Reference(configuration).fly()))
    flown.verdicts().verdict
    """

    configuration: FlockConfiguration
    states: Sequence[FlockState]

    def snapshots(self) -> Iterator[FlockState]:
        """Yield all states."""
        return iter(self.states)

    def snapshots_at(self, steps: Sequence[int]) -> Iterator[FlockState]:
        """Yield the states at `steps`."""
        return (state for state in self.states if state.step in steps)

    def verdicts(self) -> Verdicts:
        """Return the verdicts on the flight to its last state."""
        return flight_verdicts(self, self.states[-1], self.configuration.pushes)


def flight_verdicts(
    flight: Recorded, end: FlockState, perturbations: Iterable[Perturbation]
) -> Verdicts:
    """Return the verdicts on `flight` up to its recorded state `end`.

    `perturbations` are all pushes of the flight, also later ones.
    """
    flown = flight.configuration
    pushes = [push for push in perturbations if push.step <= end.step]
    shortest = shortest_time(Scales.of(flown))
    start = [0] * flown.members
    for push in pushes:
        start[push.member - 1] = max(start[push.member - 1], push.step)
    judged: dict[int, tuple[str, str]] = {}
    for step in sorted(set(start)):
        members = [m for m in range(flown.members) if start[m] == step]
        times, position = _second_half(flight, step, end.step, members)
        found = judge(times, position, flown.time(step), shortest)
        judged |= dict(zip(members, found, strict=True))
    return collected(flown.members, judged, _stalls(flight, end, pushes))


def _second_half(
    flight: Recorded, start: int, end: int, members: Sequence[int]
) -> tuple[FloatArray, FloatArray]:
    """Return times, (rows,), and positions, (rows, birds, members), of evenly spaced rows.

    They lie in the second half of the flight from step `start` to the recorded step `end`.
    """
    every = flight.configuration.record_every
    first = min(-(-(start + end) // (2 * every)), end // every)
    steps = [row * every for row in evenly(first, end // every)]
    found = list(flight.snapshots_at(steps))
    if not found:
        raise FlockError(
            f"the bag has no complete state at the times of steps {steps[0]} to {steps[-1]}, so"
            " there is no verdict: take another copy of the bag"
        )
    return (
        np.array([state.time for state in found]),
        np.stack([state.position[:, members] for state in found]),
    )


def _stalls(flight: Recorded, end: FlockState, pushes: Iterable[Perturbation]) -> dict[int, Stall]:
    """Return the first stall of each member, by its index, up to the state `end`.

    A bird that has stalled does not fly again unless it is pushed. So all recorded steps are read
    only if a bird does not fly at the end, or at the last recorded step before a push.
    """
    every = flight.configuration.record_every
    rows = sorted({(push.step - 1) // every * every for push in pushes if push.step > 0})
    checked = [*(flight.snapshots_at(rows) if rows else ()), end]
    grounded = {int(m) for state in checked for m in np.flatnonzero(~_flying(state).all(axis=0))}
    stalls: dict[int, Stall] = {}
    before: FloatArray | None = None
    for state in flight.snapshots() if grounded else ():
        before = state.speed if before is None else before
        flying = _flying(state)
        for m in grounded - stalls.keys():
            if not flying[:, m].all():
                stalls[m] = Stall(first_stalled(before[:, m], flying[:, m]), state.time)
        if stalls.keys() == grounded:
            break
        before = state.speed
    return stalls


def _flying(state: FlockState) -> BoolArray:
    return flies(state.position, state.speed)
