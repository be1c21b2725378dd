# SPDX-License-Identifier: Apache-2.0
"""The reference: the whole flock in one loop. The distributed flight must equal it bit for bit."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator

import numpy as np

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.configuration.perturbation import Perturbation, in_order
from flock_sim.links.channel import hear, hearing
from flock_sim.links.link_table import SOURCE, TARGET
from flock_sim.physics import formation
from flock_sim.physics.arrays import FloatArray
from flock_sim.physics.flock import Flock
from flock_sim.physics.flock_state import FlockState
from flock_sim.physics.runge_kutta import STAGES
from flock_sim.physics.stage_kernels import sum_up
from flock_sim.reference.flock_kernel import RECORDED, flying


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
        self._forces, self._advance = flying(hear if plain else hearing())
        plan = configuration.link_table.plan(range(1, 1 if plain else birds + 1), members)
        pairs = self.flock.pairs
        interacting = pairs if plain else plan.links[:, [TARGET, SOURCE]] - 1
        self._flown = (
            self.flock.elements,
            pairs if plain else pairs[:0],
            plan.links,
            plan.faults,
            plan.memory(),
            self.flock.interactions(interacting),
        )
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
            for k, arrays in enumerate(self.advance(count)):
                step = first + k * every
                yield FlockState(step, configuration.time(step), *arrays)
            if self.step == steps:
                if steps % every == 0:
                    yield FlockState(steps, configuration.time(steps), *self.observe())
                return

    def advance(self, steps: int) -> FloatArray:
        """Take `steps` steps; return the states recorded on the way.

        The result has shape (records, 6, birds, members): the ARRAYS of a state at the beginning of
        every step taken that is a multiple of `record_every`.
        """
        end = self.step + steps
        due = self._records_before(end) - self._records_before(self.step)
        recorded = np.empty((due, RECORDED, *self.position.shape))
        rest = recorded
        while self.step < end:
            until = min(end, self._pushes[0].step) if self._pushes else end
            count = self._records_before(until) - self._records_before(self.step)
            self._integrate(until, rest[:count])
            rest = rest[count:]
            self._push()
        return recorded

    def _records_before(self, step: int) -> int:
        """Return how many steps below `step` are recorded."""
        return -(-step // self.configuration.record_every)

    def _integrate(self, until: int, recorded: FloatArray) -> None:
        """Take all steps to the beginning of step `until`, before its pushes."""
        flown = self.configuration
        self._advance(
            self.position,
            self.speed,
            flown.dt,
            self.step,
            until,
            flown.record_every,
            *self._flown,
            self._sums,
            recorded,
        )
        self.step = until

    def _push(self) -> None:
        """Apply the perturbations of the present step."""
        while self._pushes and self._pushes[0].step == self.step:
            perturbation = self._pushes.popleft()
            row = perturbation.bird - 1
            perturbation.push(self.position[row], self.speed[row])

    def observe(self) -> FloatArray:
        """Return the present state as `advance` records it, shape (6, birds, members)."""
        coefficients, pairs, links, faults, memory, interactions = self._flown
        circulation, drag = np.empty_like(self.speed), np.empty_like(self.speed)
        self._forces(
            STAGES * self.step,
            self.configuration.dt,
            coefficients,
            pairs,
            links,
            faults,
            memory.copy(),  # a copy: the next step receives the present messages
            interactions,
            self.position,
            self.speed,
            circulation,
            drag,
        )
        sums, step, every = self._sums.copy(), self.step, self.configuration.record_every
        sum_up(step, every, self.speed.ravel(), drag.ravel(), *sums)
        means = sums.reshape(2, *drag.shape) / self.configuration.steps_averaged(step)
        return np.stack([self.position, self.speed, circulation, drag, *means])
