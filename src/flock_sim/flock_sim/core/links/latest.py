# SPDX-License-Identifier: Apache-2.0
"""What one bird knows of its neighbours in a free flight: the latest that the network brought.

Nothing is awaited and nothing decided here: which message is the latest, and how old it is when it
is used, is up to the network. The model of a link makes of it what is known, as in lockstep.
"""

from __future__ import annotations

import numpy as np

from flock_sim.core.configuration import FlockConfiguration
from flock_sim.core.kernel import FloatArray, IntArray, kernel
from flock_sim.core.links.linear import LINEAR
from flock_sim.core.links.registry import MODELS, know
from flock_sim.core.links.settings import Settings
from flock_sim.core.messages import Stage
from flock_sim.core.runge_kutta import NODES
from flock_sim.core.stage_message import FIRST_WORD, stage_words
from flock_sim.errors import FlockError

POSITION, SPEED, CIRCULATION, RATE = range(4)


def check_links(configuration: FlockConfiguration) -> None:
    """Raise FlockError where a link of the flock is set to have what only lockstep can give it."""
    for settings in configuration.linkage.used():
        if not settings.faultless or settings.interval > 1:
            raise FlockError(
                f"link {settings.text!r}: in a free flight the network itself is late and loses, "
                f"and every step is sent; leave out all but {MODELS[settings.model].name}"
            )


class Latest:
    """The latest state of each of `neighbours` of a bird; before there is one, nothing is felt."""

    def __init__(
        self, bird: int, neighbours: tuple[int, ...], configuration: FlockConfiguration
    ) -> None:
        """Have heard nothing."""
        members, linkage = configuration.members, configuration.linkage
        self._dt = configuration.dt
        self._place = {other: k for k, other in enumerate(neighbours)}
        self._models = np.array(
            [_model(linkage.of(other, bird)) for other in neighbours], dtype=np.int64
        )
        self._values = np.zeros((len(neighbours), RATE + 1, members))
        self._known = np.zeros((2, len(neighbours), stage_words(members)))
        self.steps: IntArray = np.full(len(neighbours), -1, dtype=np.int64)
        """The step of each state, shape (neighbours,); -1 where there is none."""
        self.sent: FloatArray = np.full(len(neighbours), -np.inf)
        """When it was sent, in s of the clock that the bird flies by, shape (neighbours,)."""

    @property
    def complete(self) -> bool:
        """Whether every neighbour has been heard."""
        return bool(np.all(self.steps >= 0))

    def take(self, message: Stage, sent: float) -> bool:
        """Take the state at the beginning of a step; return whether it is newer than what is known.

        `sent` is when it was sent, in s.
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
        """Return what is known at a stage of `step`, as `feel_and_move` takes it."""
        _fill(step, stage, self._dt, self._models, self.steps, self._values, self._known[stage & 1])
        return self._known


def _model(settings: Settings) -> int:
    """Return the place in MODELS of the model that is flown freely by.

    A model that needs a message for every Runge-Kutta stage can't be had without waiting; what
    comes nearest to it is to move the neighbour on.
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
    """Fill the positions and circulations of `known` (neighbours, words)."""
    members = values.shape[2]
    circulation = FIRST_WORD + 2 * (members + 1)
    for k in range(values.shape[0]):
        age = (step - steps[k] + NODES[stage]) * dt
        for m in range(members):
            known[k, FIRST_WORD + m], known[k, circulation + m] = know(
                models[k],
                age,
                values[k, POSITION, m],
                values[k, SPEED, m],
                values[k, CIRCULATION, m],
                values[k, RATE, m],
            )
