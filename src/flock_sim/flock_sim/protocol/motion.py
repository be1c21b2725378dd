# SPDX-License-Identifier: Apache-2.0
"""The motion of one bird: its own values at each stage, and its messages about them."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.configuration.perturbation import Perturbation
from flock_sim.forcing.bird_forcing import BirdForcing
from flock_sim.messages.stage_layout import stage_bytes, stage_numbers, stage_words
from flock_sim.messages.state import NOTHING
from flock_sim.messages.types import Checkpoint, Memory, State
from flock_sim.physics import formation
from flock_sim.physics.arrays import FloatArray
from flock_sim.physics.runge_kutta import STAGES
from flock_sim.physics.scaling import Scales
from flock_sim.protocol.bird_kernel import (
    DRAG,
    DRAG_SUM,
    POSITION,
    SPEED,
    SPEED_SUM,
    WORK_ROWS,
    begin,
    constants,
    feel_and_move,
)
from flock_sim.protocol.link_receiver import LinkReceiver
from flock_sim.protocol.neighbours import Neighbourhood
from flock_sim.protocol.stage_inbox import StageInbox
from flock_sim.protocol.stage_words import EVERY, FORCING, FORCING_WORDS, OWN, SENT, say


class Motion:
    """The values of one bird."""

    def __init__(self, bird: int, configuration: FlockConfiguration, around: Neighbourhood) -> None:
        """Take the coefficients of `bird`."""
        members = configuration.members
        self.bird = bird
        self._configuration = configuration
        self._dt, self._every = configuration.dt, configuration.record_every
        self._interactions = around.interactions
        self._own = constants(bird, configuration)
        self._mine = np.zeros((2, stage_words(members)))
        self._work = np.zeros((WORK_ROWS, members))
        self._around = around
        self._forcing = forcing_of(bird, configuration, self._own, around)
        self._forcing_words = self._forcing.words if self._forcing else np.zeros(0, dtype=np.int64)
        for values in self._mine:
            stage_bytes(values, members)

    def start(self) -> None:
        """Take the values of the start of the flight."""
        self._work[POSITION] = formation.start_position(self.bird, self._configuration.birds)
        self._work[SPEED] = Scales.of(self._configuration).cruise_speed
        if self._forcing:
            self._forcing.begin()
        begin(self._own, self._mine, self._work)

    def push(self, pushes: Iterable[Perturbation]) -> None:
        """Apply perturbations at the beginning of a step."""
        for push in pushes:
            push.push(self._work[POSITION], self._work[SPEED])
        begin(self._own, self._mine, self._work)

    def compute(self, tick: int, heard: FloatArray) -> None:
        """Compute the drag at `tick`, and the values at the next tick.

        `heard` has the messages of the neighbours, as in `feel_and_move`.
        """
        feel_and_move(
            tick,
            self._dt,
            self._every,
            self._own,
            self._interactions,
            heard,
            self._mine,
            self._work,
            self._forcing_words,
        )
        self.check(tick)

    def learn_geometry(self) -> None:
        """Take the lateral distances to the neighbours, once all their wings are known."""
        if self._forcing:
            self._forcing.lateral[:] = self._around.lateral

    def check(self, tick: int) -> None:
        """Raise RunFailed if a law has failed at `tick`."""
        if self._forcing:
            self._forcing.check(tick // STAGES)

    def numbers(self, tick: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return position, speed and circulation at `tick`, each of shape (members,)."""
        return stage_numbers(self._mine[tick & 1], self._configuration.members)

    def state(self, step: int, run_id: int, epoch: int) -> State:
        """Return the state at the beginning of `step`, once its drag is computed."""
        configuration, work = self._configuration, self._work
        averaged = configuration.steps_averaged(step)
        return State.at(
            configuration,
            step,
            *self.numbers(STAGES * step),
            interaction_drag=work[DRAG],
            mean_speed=work[SPEED_SUM] / averaged,
            mean_interaction_drag=work[DRAG_SUM] / averaged,
            forcing_state=self._forcing.start.ravel() if self._forcing else NOTHING,
            run_id=run_id,
            epoch=epoch,
        )


class LockstepMotion(Motion):
    """The values of one bird in lockstep, which the words of its inbox point to."""

    def __init__(
        self,
        bird: int,
        configuration: FlockConfiguration,
        around: Neighbourhood,
        inbox: StageInbox,
    ) -> None:
        """Take the coefficients of `bird`, and let the words of `inbox` point to its values."""
        super().__init__(bird, configuration, around)
        self._inbox = inbox
        self._said = np.zeros_like(self._mine)
        self.outbox = [stage_bytes(values, configuration.members) for values in self._said]
        """Its last two stage messages: one for each side of the inbox."""
        remembers = configuration.link_table.remembers(bird)
        self._receiver = LinkReceiver(bird, configuration) if remembers else None
        inbox.words[EVERY] = self._every
        arrays = (self._own, self._interactions, inbox.heard, self._mine, self._work, self._said)
        for address, array in enumerate(arrays, OWN):
            assert array.flags.c_contiguous
            inbox.words[address] = array.ctypes.data
        inbox.words[FORCING] = self._forcing_words.ctypes.data
        inbox.words[FORCING_WORDS] = len(self._forcing_words)

    @property
    def only_exchanges(self) -> bool:
        """Whether a stage needs no more than the exchange of messages and the kernel."""
        return self._inbox.every_tick and not self._receiver

    def begin(self, checkpoint: Checkpoint) -> None:
        """Take the values of a checkpoint; an empty one is the start of the flight."""
        if len(checkpoint.position):
            members = self._configuration.members
            mine = slice((self.bird - 1) * members, self.bird * members)
            self._work[POSITION] = checkpoint.position[mine]
            self._work[SPEED] = checkpoint.speed[mine]
            if self._forcing:
                self._forcing.begin(self._forcing_state(checkpoint))
            begin(self._own, self._mine, self._work)
        else:
            self.start()
        if self._receiver:
            self._receiver.begin(checkpoint.memory)

    def advance(self, tick: int) -> None:
        """Compute the values at the next tick from the messages of `tick`, which are here."""
        heard = self._inbox.heard
        if self._receiver is not None:
            heard = self._receiver.listen(
                tick, self._interactions, heard[self._inbox.side], self._mine
            )
        self.compute(tick, heard)

    def _forcing_state(self, checkpoint: Checkpoint) -> FloatArray:
        """Return the forcing state of this bird in a checkpoint, (numbers, members)."""
        rows = len(self._forcing.start) if self._forcing else 0
        birds, members = self._configuration.birds, self._configuration.members
        return np.asarray(checkpoint.forcing_state.reshape(birds, rows, members)[self.bird - 1])

    def say(self) -> bytes:
        """Return the message with the values at this tick, which has an exchange."""
        say(self._inbox.words)
        return bytes(self.outbox[self._inbox.side])

    @property
    def last_said(self) -> list[bytes]:
        """The last two messages of this epoch, the later one last."""
        sent, side = self._inbox.word[SENT], self._inbox.side
        return [bytes(self.outbox[side]) for side in (1 - side, side)[max(0, 2 - sent) :]]

    def memory(self, step: int, run_id: int, epoch: int) -> Memory | None:
        """Return what the bird remembers of its neighbours; None if its links remember nothing."""
        if self._receiver is None:
            return None
        return Memory(run_id, step, epoch, self.bird, self._receiver.memory.ravel())


def forcing_of(
    bird: int, configuration: FlockConfiguration, own: FloatArray, around: Neighbourhood
) -> BirdForcing | None:
    """Return the forcing of a bird; None if the flock has none. `own` are its constants."""
    table = configuration.forcing_table
    if not table.entries:
        return None
    ratio = configuration.span_ratio[bird - 1]
    return BirdForcing(bird, configuration.birds, table, own, ratio, around.birds, configuration.dt)
