# SPDX-License-Identifier: Apache-2.0
"""The control of a bird: a force of its own choice, in addition to thrust and drag."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.errors import FlockError
from flock_sim.messages.stage_layout import stage_numbers
from flock_sim.physics.arrays import FloatArray
from flock_sim.physics.runge_kutta import NODES, STAGES
from flock_sim.protocol.bird_kernel import THRUST


@dataclass(frozen=True)
class Perception:
    """Known values of a bird at a Runge-Kutta stage: its own, and by its links its neighbours'."""

    bird: int
    """Its number, 1..N."""
    time: float
    """Time of the stage, in b / U_min."""
    position: FloatArray
    """Its own position, shape (members,), in b."""
    speed: FloatArray
    """Its own speed, shape (members,), in U_min."""
    neighbours: tuple[int, ...]
    """The birds that it feels, in ascending order."""
    positions: FloatArray
    """Positions of the neighbours, shape (neighbours, members), in b; nan if not known."""


Control = Callable[[Perception], FloatArray | float]
"""The force on a bird, forward, in rho b^2 U_min^2: shape (members,), or one number for all.

It may depend on its argument only, and must return the same result for the same argument: after a
fault a flight continues from the data on disk, which has no internal state of a control.
"""


class Steering:
    """Adds the force of the control to the thrust of a bird, stage by stage.

    So one kernel moves all birds, and the force is integrated like the drag: by all four stages.
    """

    def __init__(
        self,
        bird: int,
        control: Control,
        own: FloatArray,
        neighbours: tuple[int, ...],
        configuration: FlockConfiguration,
    ) -> None:
        """Steer by `control`; `own` are the bird's constants, as `feel_and_move` takes them."""
        self._bird = bird
        self._control = control
        self._own = own
        self._thrust = own[THRUST].copy()
        self._neighbours = neighbours
        self._dt = configuration.dt

    def steer(self, tick: int, heard: FloatArray, mine: FloatArray) -> None:
        """Set the thrust at `tick`; `heard` and `mine` are those of `feel_and_move`.

        Raises FlockError if the control returns a value that is no force.
        """
        step, stage = divmod(tick, STAGES)
        members = len(self._thrust)
        position, speed, _ = stage_numbers(mine[tick & 1], members)
        positions, _, circulations = stage_numbers(heard[tick & 1].T, members)
        view = Perception(
            self._bird,
            (step + NODES[stage]) * self._dt,
            position.copy(),
            speed.copy(),
            self._neighbours,
            # An unknown neighbour has circulation 0, as in the drag.
            np.where(circulations == 0.0, np.nan, positions).T,
        )
        force = self._control(view)
        if np.shape(force) not in ((), (members,)):
            raise FlockError(
                f"the control of bird {self._bird} returns {force!r}: must be one number, or "
                f"{members}, one for each member"
            )
        self._own[THRUST] = self._thrust + force
