# SPDX-License-Identifier: Apache-2.0
"""The state of a flock at one time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from flock_sim.physics import formation
from flock_sim.physics.arrays import FloatArray
from flock_sim.physics.scaling import Scales, drag_reduction

if TYPE_CHECKING:
    from flock_sim.messages.types import State


@dataclass(frozen=True)
class FlockState:
    """A flock at the beginning of a step; arrays of shape (birds, members), or (birds,) for one."""

    step: int
    time: float
    """t, in b / U_min."""
    position: FloatArray
    """x_i, in b."""
    speed: FloatArray
    """U_i, in U_min."""
    circulation: FloatArray
    """Gamma_i, in b U_min."""
    interaction_drag: FloatArray
    """sum_j D_ji, in rho b^2 U_min^2; negative where drag is saved."""
    mean_speed: FloatArray
    """U_i, the mean over the steps since the last recorded state; nan if it was not recorded."""
    mean_interaction_drag: FloatArray
    """sum_j D_ji, the mean over the same steps."""
    forcing_state: FloatArray = field(default_factory=lambda: np.empty((0, 0, 0)))
    """The state of all forcing laws, shape (birds, numbers, members); empty without any."""

    @classmethod
    def of(cls, states: Sequence[State]) -> FlockState:
        """Return the state of a flock from those of its birds, in order, all of one step."""
        return cls(
            states[0].step,
            states[0].time,
            position=np.stack([state.position for state in states]),
            speed=np.stack([state.speed for state in states]),
            circulation=np.stack([state.circulation for state in states]),
            interaction_drag=np.stack([state.interaction_drag for state in states]),
            mean_speed=np.stack([_known(state.mean_speed, state) for state in states]),
            mean_interaction_drag=np.stack(
                [_known(state.mean_interaction_drag, state) for state in states]
            ),
            forcing_state=_forcing_state(states),
        )

    def member(self, m: int) -> FlockState:
        """Return the state of the flock with index `m`, with arrays of shape (birds,)."""
        arrays = (
            self.position,
            self.speed,
            self.circulation,
            self.interaction_drag,
            self.mean_speed,
            self.mean_interaction_drag,
        )
        state = self.forcing_state[:, :, m] if self.forcing_state.size else self.forcing_state
        own = FlockState(self.step, self.time, *(values[:, m] for values in arrays))
        return replace(own, forcing_state=state)

    @property
    def from_leader(self) -> FloatArray:
        """x_i relative to the leader, in b, in the shape of `position`."""
        leader = formation.leader(len(self.position))
        return np.asarray(self.position - self.position[leader - 1])

    @property
    def spacing(self) -> FloatArray:
        """x_{i+1} - x_i, in b, shape (birds - 1, members)."""
        return np.diff(self.position, axis=0)

    @property
    def finite(self) -> npt.NDArray[np.bool_]:
        """Whether all positions and speeds of a flock are finite, shape (members,)."""
        return np.asarray((np.isfinite(self.position) & np.isfinite(self.speed)).all(axis=0))

    def drag_reduction(self, scales: Scales) -> FloatArray:
        """Return eta_i in the shape of `interaction_drag`."""
        return drag_reduction(self.interaction_drag, scales.cruise_drag)


def _known(means: FloatArray, state: State) -> FloatArray:
    """Return the means in a state; nan where it has none, as those of earlier versions."""
    return means if len(means) else np.full(len(state.speed), np.nan)


def _forcing_state(states: Sequence[State]) -> FloatArray:
    """Return the forcing states of all birds, (birds, numbers, members); empty if they differ."""
    lengths = {len(state.forcing_state) for state in states}
    members = len(states[0].speed)
    if len(lengths) > 1 or max(lengths) % members:
        return np.empty((0, 0, 0))
    return np.stack([state.forcing_state.reshape(-1, members) for state in states])
