# SPDX-License-Identifier: Apache-2.0
"""The checkpoints that epochs begin from, as one bird receives them."""

from __future__ import annotations

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.configuration.perturbation import Perturbation, perturbations
from flock_sim.errors import FlockError
from flock_sim.messages.epochs import out_of_date
from flock_sim.messages.rejection import FOREIGN, IMPOSSIBLE, REPEATED
from flock_sim.messages.types import Checkpoint
from flock_sim.protocol.session import Session

EARLY = 16
"""Most checkpoints kept for epochs that may begin later."""


class Checkpoints:
    """The checkpoints of this epoch and of later ones. The run may not be known yet."""

    def __init__(self, bird: int, configuration: FlockConfiguration, session: Session) -> None:
        """Keep none so far."""
        self._bird, self._configuration, self._session = bird, configuration, session
        self._kept: dict[tuple[int, int], Checkpoint] = {}  # by run and epoch

    @property
    def now(self) -> Checkpoint | None:
        """The checkpoint of this epoch, if it has arrived."""
        return self._kept.get(self._session.now)

    def take(self, checkpoint: Checkpoint) -> str:
        """Keep a checkpoint; return why it is ignored, or ""."""
        if reason := self._session.refuses(checkpoint.run_id, checkpoint.epoch):
            return reason
        key = checkpoint.run_id, checkpoint.epoch
        if key in self._kept:
            return REPEATED
        if not self._fits(checkpoint):
            return IMPOSSIBLE
        self._kept[key] = checkpoint
        if len(self._kept) > EARLY:
            oldest = next(key for key in self._kept if key != self._session.now)
            del self._kept[oldest]
            return "" if key == self._session.now else FOREIGN
        return ""

    def forget_old(self) -> None:
        """Drop those of other runs and of epochs that are over."""
        run_id, epoch = self._session.now
        self._kept = {
            key: checkpoint
            for key, checkpoint in self._kept.items()
            if key[0] == run_id and not out_of_date(key[1], epoch)
        }

    def pushes(self, checkpoint: Checkpoint) -> dict[int, list[Perturbation]]:
        """Return the pushes of this bird, by step, in their order.

        Raises FlockError if the checkpoint names a bird, member or step that the flight has not.
        """
        configuration = self._configuration
        live = perturbations(
            checkpoint.perturbations.split(),
            configuration.birds,
            configuration.members,
            configuration.steps,
        )
        pushes: dict[int, list[Perturbation]] = {}
        for push in (*configuration.pushes, *live):
            if push.bird == self._bird:
                pushes.setdefault(push.step, []).append(push)
        return pushes

    def _fits(self, checkpoint: Checkpoint) -> bool:
        """Whether a checkpoint can belong to this flight."""
        configuration = self._configuration
        size = len(checkpoint.position)
        try:
            self.pushes(checkpoint)
        except FlockError:
            return False
        memory = configuration.link_table.memory_ends[-1] if size else 0
        numbers = configuration.forcing_table.states if size else 0
        return (
            size == len(checkpoint.speed)
            and size in (0, configuration.birds * configuration.members)
            and checkpoint.step <= (configuration.steps if size else 0)
            and checkpoint.step % configuration.record_every == 0
            and len(checkpoint.memory) == memory * configuration.members
            and len(checkpoint.forcing_state)
            == numbers * configuration.birds * configuration.members
        )
