# SPDX-License-Identifier: Apache-2.0
"""A flock at one moment, and the frame that moves with it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np
import numpy.typing as npt

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.physics import formation
from flock_sim.physics.arrays import FloatArray
from flock_sim.physics.flock_state import FlockState
from flock_sim.physics.scaling import Scales
from flock_tools.scene.marker import in_metres

FARTHEST = 1e9
"""Largest distance of a bird from the origin that is drawn, in b. Rounding is invisible there."""


@dataclass(frozen=True)
class Snapshot:
    """One member of a flock at one step, to be drawn; arrays of shape (birds,)."""

    configuration: FlockConfiguration
    member: int
    """Index of the member, below `members`."""
    members: int
    stamp: tuple[int, int]
    """Simulated time, in s and ns."""
    state: FlockState
    span_ratio: FloatArray

    @classmethod
    def of(
        cls,
        configuration: FlockConfiguration,
        state: FlockState,
        span_ratio: FloatArray,
        m: int,
        stamp: tuple[int, int],
    ) -> Self:
        """Return the member with index `m` of `state`. `span_ratio` has shape (birds, members)."""
        members = span_ratio.shape[1]
        return cls(configuration, m, members, stamp, state.member(m), span_ratio[:, m])

    @property
    def known(self) -> npt.NDArray[np.bool_]:
        """Which birds can be drawn: position and circulation are finite, and it is not too far."""
        with np.errstate(invalid="ignore", over="ignore"):
            return self._finite & (np.abs(self.along) <= FARTHEST)

    @property
    def _finite(self) -> npt.NDArray[np.bool_]:
        return np.isfinite(self.state.position) & np.isfinite(self.state.circulation)

    @property
    def origin(self) -> float:
        """Origin of the frame, in b along the flight: the position of the leader.

        If its state is not finite, the position of the bird in the middle of those whose state is;
        0 if there is none.
        """
        position, finite = self.state.position, self._finite
        leader = formation.leader(len(position)) - 1
        if not finite.any():
            return 0.0
        if finite[leader]:
            return float(position[leader])
        return formation.middle_position(position[finite])

    @property
    def along(self) -> FloatArray:
        """Positions of the birds in the frame, in b."""
        return self.state.position - self.origin

    @cached_property
    def lateral(self) -> FloatArray:
        """Lateral positions of the birds to the right of the leader, in b."""
        return formation.lateral_positions(self.span_ratio[:, np.newaxis])[:, 0]

    @cached_property
    def world(self) -> FloatArray:
        """x, y and z of the birds in the frame in which the air is at rest, in m, (birds, 3)."""
        level = np.zeros_like(self.lateral)
        place = np.column_stack([self.state.position, self.lateral, level])
        with np.errstate(over="ignore"):  # of a bird that diverges
            return in_metres(place, self.metre) + 0.0  # no -0.0

    @cached_property
    def world_speed(self) -> FloatArray:
        """Speeds of the birds, in m/s."""
        with np.errstate(over="ignore"):
            return self.state.speed * self.configuration.min_drag_speed

    @cached_property
    def finite_birds(self) -> list[int]:
        """The birds whose position and speed are finite, in SI units too; bird numbers from 1."""
        finite = np.isfinite(self.world[:, 0]) & np.isfinite(self.world_speed)
        return [int(i) + 1 for i in np.flatnonzero(finite)]

    @cached_property
    def saved(self) -> FloatArray:
        """Drag reduction eta, in %."""
        return 100.0 * self.state.drag_reduction(Scales.of(self.configuration))

    @property
    def metre(self) -> float:
        """b, in m."""
        return 0.5 * self.configuration.wing_span
