# SPDX-License-Identifier: Apache-2.0
"""Steady formations in numbers: the position and the drag reduction of each bird."""

from __future__ import annotations

from dataclasses import dataclass

from flock_sim.physics import formation
from flock_sim.physics.arrays import FloatArray
from flock_sim.physics.flock import Flock
from flock_sim.theory.equilibrium import equilibrium


@dataclass(frozen=True)
class Steady:
    """Steady states of the members of a flock; nan for a member without one."""

    along: FloatArray
    """x_i from the leader, shape (birds, members), in b."""
    across: FloatArray
    """y_i from the leader, shape (birds, members), in b."""
    speed: FloatArray
    """U*, shape (members,), in U_min."""
    drag_reduction: FloatArray
    """eta_i, shape (birds, members)."""


def steady(flock: Flock) -> Steady:
    """Return the steady states of all members of `flock`."""
    state = equilibrium(flock)
    along = formation.positions(state.spacing)
    along -= along[formation.leader(flock.birds) - 1]
    return Steady(
        along=along,
        across=formation.lateral_positions(flock.span_ratio),
        speed=state.speed,
        drag_reduction=state.drag_reduction,
    )
