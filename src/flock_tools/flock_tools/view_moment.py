# SPDX-License-Identifier: Apache-2.0
"""A flock at one moment, and the frame that moves with it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
import numpy.typing as npt

from flock_sim.core import formation
from flock_sim.core.configuration import FlockConfiguration
from flock_sim.core.kernel import FloatArray
from flock_sim.core.messages import State
from flock_sim.core.scaling import Scales


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
        """Return the flock with index `m` as its `states` tell, one a bird and all of one step.

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
        """Which birds are anywhere."""
        return np.isfinite(self.position) & np.isfinite(self.circulation)

    @property
    def origin(self) -> float:
        """Where the frame is, in b along the flight: where the leader is.

        If that is nowhere, in the middle of those that are anywhere; 0 without one.
        """
        leader = formation.leader(len(self.position)) - 1
        known = self.known
        if not known.any():
            return 0.0
        return float(self.position[leader] if known[leader] else np.median(self.position[known]))

    @property
    def along(self) -> FloatArray:
        """Where the birds are in the frame, in b."""
        return self.position - self.origin

    @property
    def lateral(self) -> FloatArray:
        """How far the birds are to the right of the leader, in b."""
        return formation.lateral_positions(self.span_ratio[:, np.newaxis])[:, 0]

    @property
    def saved(self) -> FloatArray:
        """Drag reduction eta, in %."""
        return 100.0 * (0.0 - self.interaction_drag) / Scales.of(self.configuration).cruise_drag

    @property
    def metre(self) -> float:
        """b, in m."""
        return 0.5 * self.configuration.wing_span
