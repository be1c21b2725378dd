# SPDX-License-Identifier: Apache-2.0
"""A force of a bird's own choice, besides thrust and drag: its control."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from flock_sim.core.bird_step import THRUST
from flock_sim.core.configuration import FlockConfiguration
from flock_sim.core.kernel import FloatArray
from flock_sim.core.runge_kutta import NODES, STAGES
from flock_sim.core.stage_message import stage_numbers
from flock_sim.errors import FlockError


@dataclass(frozen=True)
class View:
    """What a bird knows at a Runge-Kutta stage: of itself, and by its links of its neighbours."""

    bird: int
    """Its number, 1..N."""
    time: float
    """That of the stage, in b / U_min."""
    position: FloatArray
    """Its own, shape (members,), in b."""
    speed: FloatArray
    """Its own, shape (members,), in U_min."""
    neighbours: tuple[int, ...]
    """The birds that it feels, in ascending order."""
    positions: FloatArray
    """Those of the neighbours, shape (neighbours, members), in b; nan of whom it knows nothing."""


Control = Callable[[View], FloatArray | float]
"""The force on a bird, forward, in rho b^2 U_min^2: shape (members,), or one number for all.

It may depend on its argument only, and has to give the same for the same: after a fault a flight is
gone on with from what is on disk, and what a control remembers is not there.
"""


class Steering:
    """Adds to the thrust of a bird what its control asks for, stage by stage.

    So the kernel that moves birds is the same for all of them, and a force is integrated as well as
    drag is: by all four stages.
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

        Raises FlockError where the control gives what is no force.
        """
        step, stage = divmod(tick, STAGES)
        members = len(self._thrust)
        position, speed, _ = stage_numbers(mine[tick & 1], members)
        positions, _, circulations = stage_numbers(heard[tick & 1].T, members)
        view = View(
            self._bird,
            (step + NODES[stage]) * self._dt,
            position.copy(),
            speed.copy(),
            self._neighbours,
            # Who is not known has no circulation, as the drag has it.
            np.where(circulations == 0.0, np.nan, positions).T,
        )
        force = self._control(view)
        if np.shape(force) not in ((), (members,)):
            raise FlockError(
                f"the control of bird {self._bird} gives {force!r}: must be one number, or "
                f"{members}, one a member"
            )
        self._own[THRUST] = self._thrust + force
