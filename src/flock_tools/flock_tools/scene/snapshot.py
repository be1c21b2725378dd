# SPDX-License-Identifier: Apache-2.0
"""A flock at one moment, and the frame that moves with it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
import numpy.typing as npt

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.messages.types import State
from flock_sim.physics import formation
from flock_sim.physics.arrays import FloatArray
from flock_sim.physics.scaling import Scales


@dataclass(frozen=True)
class Moment:
    """One member of a flock at one step; arrays of shape (birds,), dimensionless."""

    configuration: FlockConfiguration
    member: int
    members: int
    time: float
    stamp: tuple[int, int]
    """Simulated time, in s and ns."""
    position: FloatArray
    circulation: FloatArray
    interaction_drag: FloatArray
    span_ratio: FloatArray

    @classmethod
    def of(
        cls,
        configuration: FlockConfiguration,
        states: Sequence[State],
        span_ratio: FloatArray,
        m: int,
    ) -> Self:
        """Return the flock with index `m` from `states`, one per bird and all of one step.

        `span_ratio` has shape (birds, members).
        """
        return cls(
            configuration=configuration,
            member=m,
            members=len(states[0].position),
            time=states[0].time,
            stamp=(states[0].seconds, states[0].nanoseconds),
            position=np.array([state.position[m] for state in states]),
            circulation=np.array([state.circulation[m] for state in states]),
            interaction_drag=np.array([state.interaction_drag[m] for state in states]),
            span_ratio=span_ratio[:, m],
        )

    @property
    def known(self) -> npt.NDArray[np.bool_]:
        """Which birds have a finite position and circulation."""
        return np.isfinite(self.position) & np.isfinite(self.circulation)

    @property
    def origin(self) -> float:
        """Origin of the frame, in b along the flight: the position of the leader.

        If the leader is not `known`, the median of the birds that are; 0 if none is.
        """
        leader = formation.leader(len(self.position)) - 1
        known = self.known
        if not known.any():
            return 0.0
        return float(self.position[leader] if known[leader] else np.median(self.position[known]))

    @property
    def along(self) -> FloatArray:
        """Positions of the birds in the frame, in b."""
        return self.position - self.origin

    @property
    def lateral(self) -> FloatArray:
        """Lateral positions of the birds to the right of the leader, in b."""
        return formation.lateral_positions(self.span_ratio[:, np.newaxis])[:, 0]

    @property
    def saved(self) -> FloatArray:
        """Drag reduction eta, in %."""
        return 100.0 * (0.0 - self.interaction_drag) / Scales.of(self.configuration).cruise_drag

    @property
    def metre(self) -> float:
        """b, in m."""
        return 0.5 * self.configuration.wing_span
