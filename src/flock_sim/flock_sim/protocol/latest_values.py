# SPDX-License-Identifier: Apache-2.0
"""Values that one bird has of its neighbours in a free flight: the latest received ones.

The bird does not wait. The network alone determines which message is the latest, and how old it is
when it is used. The link model computes the known values from it, as in lockstep.
"""

from __future__ import annotations

import numpy as np

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.links.compiled_model import codes, perceive
from flock_sim.links.models import LINEAR
from flock_sim.links.registry import MODELS
from flock_sim.links.settings import Settings
from flock_sim.messages.stage_layout import FIRST_WORD, stage_words
from flock_sim.messages.types import Stage
from flock_sim.physics.arrays import FloatArray, IntArray
from flock_sim.physics.compile import kernel
from flock_sim.physics.runge_kutta import NODES

POSITION, SPEED, CIRCULATION, RATE = range(4)


class LatestValues:
    """The latest state of each of a bird's `neighbours`; one without a state causes no drag."""

    def __init__(
        self, bird: int, neighbours: tuple[int, ...], configuration: FlockConfiguration
    ) -> None:
        """Start without any state."""
        members, link_table = configuration.members, configuration.link_table
        self._dt = configuration.dt
        self._place = {other: k for k, other in enumerate(neighbours)}
        used = [_model(link_table.of(other, bird)) for other in neighbours]
        self._models = codes(used)[np.array(used, dtype=np.int64)]
        self._values = np.zeros((len(neighbours), RATE + 1, members))
        self._known = np.zeros((2, len(neighbours), stage_words(members)))
        self.steps: IntArray = np.full(len(neighbours), -1, dtype=np.int64)
        """The step of each state, shape (neighbours,); -1 without a state."""
        self.sent: FloatArray = np.full(len(neighbours), -np.inf)
        """Time at which each state was sent, in s of the bird's clock, shape (neighbours,)."""

    @property
    def complete(self) -> bool:
        """Whether a state of every neighbour has arrived."""
        return bool(np.all(self.steps >= 0))

    def take(self, message: Stage, sent: float) -> bool:
        """Take the state at the beginning of a step; return whether it is newer than the last.

        `sent` is the time at which it was sent, in s.
        """
        k = self._place[message.bird]
        before = int(self.steps[k])
        if message.step <= before:
            return False
        values = self._values[k]
        if before >= 0:
            change = message.circulation - values[CIRCULATION]
            values[RATE] = change / ((message.step - before) * self._dt)
        values[POSITION], values[SPEED] = message.position, message.speed
        values[CIRCULATION] = message.circulation
        self.steps[k], self.sent[k] = message.step, sent
        return True

    def known(self, step: int, stage: int) -> FloatArray:
        """Return the known values at a stage of `step`, as `feel_and_move` takes them."""
        _fill(step, stage, self._dt, self._models, self.steps, self._values, self._known[stage & 1])
        return self._known


def _model(settings: Settings) -> int:
    """Return the index in MODELS of the model that a free flight uses.

    A model that needs a message for every Runge-Kutta stage would need waiting. The linear model is
    the nearest one without.
    """
    return MODELS.index(LINEAR) if settings.every_stage else settings.model


@kernel
def _fill(
    step: int,
    stage: int,
    dt: float,
    models: IntArray,
    steps: IntArray,
    values: FloatArray,
    known: FloatArray,
) -> None:
    """Fill positions, speeds and circulations of `known` (neighbours, words).

    `models` (neighbours,) are the codes of the link models.
    """
    members = values.shape[2]
    speed = FIRST_WORD + members + 1
    circulation = FIRST_WORD + 2 * (members + 1)
    for k in range(values.shape[0]):
        age = (step - steps[k] + NODES[stage]) * dt
        for m in range(members):
            known[k, speed + m] = values[k, SPEED, m]
            known[k, FIRST_WORD + m], known[k, circulation + m] = perceive(
                models[k],
                age,
                values[k, POSITION, m],
                values[k, SPEED, m],
                values[k, CIRCULATION, m],
                values[k, RATE, m],
            )
