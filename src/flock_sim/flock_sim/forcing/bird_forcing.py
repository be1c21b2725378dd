# SPDX-License-Identifier: Apache-2.0
"""The forcing of one bird: the arrays of its laws, and the words that name them."""

from __future__ import annotations

import numpy as np

from flock_sim.errors import RunFailed
from flock_sim.forcing import frame
from flock_sim.forcing.compiled_law import compiled_law
from flock_sim.forcing.forcing_table import ForcingTable
from flock_sim.forcing.law import SEED, signature_of
from flock_sim.forcing.registry import BUILT_IN
from flock_sim.forcing.stage import initial_normals
from flock_sim.physics import formation
from flock_sim.physics.arrays import FloatArray


class BirdForcing:
    """The forcing of one bird of a flock, in all members."""

    def __init__(
        self,
        bird: int,
        birds: int,
        table: ForcingTable,
        coefficients: FloatArray,
        span_ratio: FloatArray,
        neighbours: tuple[int, ...],
        dt: float,
    ) -> None:
        """Take the constants of a bird: `coefficients` (5, members), `span_ratio` (members,)."""
        members, count, rows = len(span_ratio), len(neighbours), table.states
        self.bird = bird
        terms = table.of(bird)
        self._names = [settings.text for settings in terms]
        self._initial = np.zeros((rows, members))
        self.now = np.zeros((3, members))
        """Position, speed and circulation of the bird at a stage."""
        self.near = np.zeros((3, members, count))
        """Those of its neighbours, as it knows them."""
        self.lateral = np.zeros((members, count))
        """Lateral distances to the neighbours, negative on the left."""
        self.force = np.zeros(members)
        """The force of all laws."""
        self.start = np.zeros((rows, members))
        """The state of all laws at the beginning of the step."""
        self.thrust = coefficients[frame.THRUST].copy()
        """The thrust of the bird without these forces."""
        self._state = np.zeros((2, rows, members))
        own = np.concatenate([coefficients, span_ratio[np.newaxis]])
        noise = np.zeros((max(1, len(terms)), 2, members))
        number = np.array(neighbours, dtype=np.int64)
        shape = rows, members
        arrays = [own, self.now, number, self.lateral, self.near, self._state, self.start]
        arrays += [np.zeros(shape), np.zeros(shape), self.force, noise]
        self.words = np.zeros(frame.FIRST_TERM + frame.EACH * len(terms), dtype=np.int64)
        """The words that `compute_force` takes; see `forcing/frame.py`."""
        words = self.words
        words[frame.BIRD], words[frame.LEADER] = bird, formation.leader(birds)
        words[frame.MEMBERS], words[frame.NEIGHBOURS] = members, count
        words[frame.STATES], words[frame.TERMS] = rows, len(terms)
        first, ordinal = 0, 0
        for place, settings in enumerate(terms):
            values = settings.values(members)
            prepared = settings.model.prepare(values, dt, coefficients[frame.MASS])
            law, signature = compiled_law(prepared.law), signature_of(prepared.law)
            parameters = np.array(
                [prepared.parameters[name] for name in signature.parameters], dtype=np.float64
            ).reshape(-1, members)
            arrays.append(parameters)
            term = words[frame.FIRST_TERM + frame.EACH * place :]
            term[frame.FUNCTION], term[frame.PARAMETERS] = law.address, parameters.ctypes.data
            term[frame.BUILT_IN] = settings.name in BUILT_IN
            term[frame.FIRST_STATE], term[frame.STATES_OF_LAW] = first, law.states
            if signature.seeded:
                seeds = np.ascontiguousarray(values[SEED], dtype=np.float64)
                arrays.append(seeds)
                term[frame.SEEDS], term[frame.ORDINAL] = seeds.ctypes.data, ordinal
                if prepared.spread is not None:
                    drawn = initial_normals(seeds, bird, ordinal)
                    self._initial[first] = prepared.spread * drawn
                ordinal += 1
            words[frame.LOOKS] |= "neighbours" in signature.given
            first += law.states
        for address, array in enumerate(arrays[: frame.NOISE - frame.OWN + 1], frame.OWN):
            words[address] = array.ctypes.data
        self._arrays = arrays  # which the words name by their addresses
        self.begin()

    def begin(self, state: FloatArray | None = None) -> None:
        """Take the state of the laws at the beginning of a step, (numbers, members).

        None: that of the start of the flight.
        """
        self.start[:] = self._initial if state is None else state
        self._state[:] = self.start
        self.words[frame.FAULT] = 0

    def check(self, step: int) -> None:
        """Raise RunFailed if a law has failed in `step`."""
        if fault := self.words[frame.FAULT]:
            raise RunFailed(self.told(step, int(fault)))

    def told(self, step: int, fault: int) -> str:
        """Return one line on the fault of a law."""
        law = self._names[self.words[frame.FAULT_TERM]]
        member = int(self.words[frame.FAULT_MEMBER])
        if fault == frame.RAISED:
            count = self.lateral.shape[1]
            return (
                f"bird {self.bird}, step {step}: the law {law!r} has raised an exception; the "
                f"bird has {count} neighbour{'s' * (count != 1)}"
            )
        of = f" in member {member}" if len(self.force) > 1 else ""
        return (
            f"bird {self.bird}, step {step}: the law {law!r} returns nan or inf{of}, although the "
            "values that it was given are finite: mend the law"
        )
