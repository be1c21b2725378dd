# SPDX-License-Identifier: Apache-2.0
"""The reference: the whole flock in one loop. The distributed flight must equal it bit for bit."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.configuration.perturbation import Perturbation, in_order
from flock_sim.forcing.bird_forcing import BirdForcing
from flock_sim.forcing.frame import FIRST_LINK
from flock_sim.links.compiled_model import codes
from flock_sim.links.link_table import MODEL, SOURCE, TARGET
from flock_sim.physics import formation
from flock_sim.physics.arrays import FloatArray, IntArray
from flock_sim.physics.flock import Flock
from flock_sim.physics.flock_state import FlockState
from flock_sim.physics.runge_kutta import STAGES
from flock_sim.physics.stage_kernels import sum_up
from flock_sim.reference.flock_kernel import RECORDED, advance, forces


class Reference:
    """A flock that is integrated as one system. `position` and `speed` are (birds, members).

    They are those at the beginning of `step`, after the pushes of this step.

    >>> flock = Reference(FlockConfiguration(birds=3, t_max=100.0))
    >>> states = list(flock.fly())
    >>> states[-1].step
    100
    """

    def __init__(
        self,
        configuration: FlockConfiguration,
        span_ratio: FloatArray | None = None,
        live: Iterable[Perturbation] = (),
    ) -> None:
        """Place the flock at its start; `span_ratio` (birds, members) replaces the configured one.

        `live` are additional perturbations. At the same step they follow the configured ones.
        """
        self.configuration = configuration
        self.flock = Flock.of(configuration, span_ratio)
        birds, members = self.flock.span_ratio.shape
        start = [formation.start_position(i, birds) for i in range(1, birds + 1)]
        self.position = np.repeat(np.array(start)[:, np.newaxis], members, axis=1)
        self.speed = np.full((birds, members), self.flock.scales.cruise_speed)
        self.step = 0
        plain = configuration.link_table.plain
        plan = configuration.link_table.plan(range(1, 1 if plain else birds + 1), members)
        pairs = self.flock.pairs
        interacting = pairs if plain else plan.links[:, [TARGET, SOURCE]] - 1
        self._forced, words = self._forcing(plan.links)
        self._flown = (
            self.flock.elements,
            pairs if plain else pairs[:0],
            codes(plan.links[:, MODEL]),
            plan.links,
            plan.faults,
            plan.memory(),
            self.flock.interactions(interacting),
            np.zeros((len(plan.links), 3, members)),
        )
        self._words = words
        self._sums = np.zeros((2, self.speed.size))
        self._pushes = deque(in_order([*configuration.pushes, *live]))
        for perturbation in self._pushes:
            perturbation.check(birds, members, configuration.steps)
        self._push()

    def fly(self, rows: int = 1024) -> Iterator[FlockState]:
        """Integrate to the end, yielding every recorded state; at most `rows` are held at once."""
        configuration = self.configuration
        steps, every = configuration.steps, configuration.record_every
        while True:
            count = min(rows * every, steps - self.step)
            first = -(-self.step // every) * every
            recorded, forcing_states = self._record(count)
            for k, (arrays, state) in enumerate(zip(recorded, forcing_states, strict=True)):
                step = first + k * every
                now = FlockState(step, configuration.time(step), *arrays)
                yield replace(now, forcing_state=state)
            if self.step == steps:
                if steps % every == 0:
                    now = FlockState(steps, configuration.time(steps), *self.observe())
                    yield replace(now, forcing_state=self.forcing_state)
                return

    def advance(self, steps: int) -> FloatArray:
        """Take `steps` steps; return the states recorded on the way.

        The result has shape (records, 6, birds, members): the ARRAYS of a state at the beginning of
        every step taken that is a multiple of `record_every`. Raises RunFailed if a law of the
        forcing fails.
        """
        return self._record(steps)[0]

    @property
    def forcing_state(self) -> FloatArray:
        """The state of all laws at the beginning of `step`, shape (birds, numbers, members)."""
        states = [forced.start for forced in self._forced]
        birds, members = self.position.shape
        return np.array(states) if states else np.empty((birds, 0, members))

    def _record(self, steps: int) -> tuple[FloatArray, FloatArray]:
        """Take `steps` steps; return the recorded arrays, and the recorded `forcing_state`."""
        end = self.step + steps
        due = self._records_before(end) - self._records_before(self.step)
        recorded = np.empty((due, RECORDED, *self.position.shape))
        states = np.empty((due, *self.forcing_state.shape))
        done = 0
        while self.step < end:
            until = min(end, self._pushes[0].step) if self._pushes else end
            count = self._records_before(until) - self._records_before(self.step)
            self._integrate(until, recorded[done : done + count], states[done : done + count])
            done += count
            self._push()
        return recorded, states

    def _forcing(self, links: IntArray) -> tuple[list[BirdForcing], IntArray]:
        """Return the forcing of all birds and their words, (birds, words); none without forcing."""
        flown, flock = self.configuration, self.flock
        birds = flock.birds
        table = flown.forcing_table
        if not table.entries:
            return [], np.zeros((0, 0), dtype=np.int64)
        forced = []
        for bird in range(1, birds + 1):
            around = formation.neighbours(bird, birds, flown.coupling)
            constants = flock.coefficients[bird - 1]
            ratio = flock.span_ratio[bird - 1]
            one = BirdForcing(bird, birds, table, constants, ratio, around, flown.dt)
            for k, other in enumerate(around):
                low, high = sorted((bird, other))
                distance = formation.lateral_distance(flock.span_ratio[low - 1 : high])
                one.lateral[:, k] = distance if other > bird else -distance
            if len(links):
                one.words[FIRST_LINK] = np.flatnonzero(links[:, TARGET] == bird)[0]
            forced.append(one)
        words = np.zeros((birds, max(len(one.words) for one in forced)), dtype=np.int64)
        for row, one in zip(words, forced, strict=True):
            row[: len(one.words)] = one.words
        return forced, words

    def _records_before(self, step: int) -> int:
        """Return how many steps below `step` are recorded."""
        return -(-step // self.configuration.record_every)

    def _integrate(self, until: int, recorded: FloatArray, states: FloatArray) -> None:
        """Take all steps to the beginning of step `until`, before its pushes."""
        flown = self.configuration
        failed = advance(
            self.position,
            self.speed,
            flown.dt,
            self.step,
            until,
            flown.record_every,
            *self._flown,
            self._words,
            self._sums,
            recorded,
            states,
        )
        if failed >= 0:
            for words, forced in zip(self._words, self._forced, strict=True):
                forced.words[:] = words[: len(forced.words)]
                forced.check(failed)
        self.step = until

    def _push(self) -> None:
        """Apply the perturbations of the present step."""
        while self._pushes and self._pushes[0].step == self.step:
            perturbation = self._pushes.popleft()
            row = perturbation.bird - 1
            perturbation.push(self.position[row], self.speed[row])

    def observe(self) -> FloatArray:
        """Return the present state as `advance` records it, shape (6, birds, members)."""
        coefficients, pairs, models, links, faults, memory, interactions, known = self._flown
        circulation, drag = np.empty_like(self.speed), np.empty_like(self.speed)
        forces(
            STAGES * self.step,
            self.configuration.dt,
            coefficients,
            pairs,
            models,
            links,
            faults,
            memory.copy(),  # a copy: the next step receives the present messages
            interactions,
            known,
            self.position,
            self.speed,
            circulation,
            drag,
        )
        sums, step, every = self._sums.copy(), self.step, self.configuration.record_every
        sum_up(step, every, self.speed.ravel(), drag.ravel(), *sums)
        means = sums.reshape(2, *drag.shape) / self.configuration.steps_averaged(step)
        return np.stack([self.position, self.speed, circulation, drag, *means])
