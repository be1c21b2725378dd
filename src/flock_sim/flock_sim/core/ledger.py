# SPDX-License-Identifier: Apache-2.0
"""What is to be recorded, put in order: messages in, as they come; complete rows out.

A row is all that belongs to one recorded step: the wings (with the first), the stages of the steps
since the row before (where stages are recorded), the time, the state of every bird, and the memory
of those who have one, or in a free flight the ages of what they knew. Rows leave in order, each
once, so that what the bag holds does not depend on how messages travelled.

States say which run and epoch they are of; in the bag they say so no more.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

from flock_sim.core.configuration import FlockConfiguration
from flock_sim.core.messages import Ages, Memory, State, Time
from flock_sim.core.runge_kutta import STAGES
from flock_sim.core.stage_inbox import FOREIGN, MISSHAPEN, REPEATED, STALE
from flock_sim.core.stage_message import stage_header


@dataclass(frozen=True)
class Row:
    """Everything to be written for one recorded step, as it came off the wire."""

    step: int
    wings: list[bytes]
    """The wing of bird 1, 2, ... N, with the first row."""
    stages: list[tuple[int, bytes]]
    """(bird, message), by step, stage and bird."""
    time: bytes
    states: list[bytes]
    """The state of bird 1, 2, ... N."""
    memories: list[bytes] = field(default_factory=list)
    """The memory of those birds that have one, in order."""
    ages: list[bytes] = field(default_factory=list)
    """The ages that bird 1, 2, ... N told of what it knew, in a free flight."""


class _Gathering:
    """A row that is not complete yet."""

    def __init__(self) -> None:
        self.stages: dict[tuple[int, int], bytes] = {}
        self.time: bytes | None = None
        self.states: dict[int, bytes] = {}
        self.memories: dict[int, bytes] = {}
        self.ages: dict[int, bytes] = {}


class Ledger:
    """Gathers the rows of one run; what comes twice or is not due is counted and left out."""

    def __init__(
        self,
        configuration: FlockConfiguration,
        record_stages: bool = False,
        saved: int = -1,
        free: bool = False,
        played: bool = False,
    ) -> None:
        """Expect every recorded step of `configuration` after `saved`; `free`: of a free flight.

        Birds that fly freely tell the ages of what they know, and have no memory to go on from.
        Nor has who is `played`: such states are of run 0, as those of a bag are.
        """
        self.ignored_for: Counter[str] = Counter()
        """How many messages were left out, by the reason."""
        self._configuration = configuration
        self._birds = range(1, configuration.birds + 1)
        self._every = configuration.record_every
        self._record_stages = record_stages
        self._rows: dict[int, _Gathering] = {}
        self._wings: dict[int, bytes] = {}
        remembers = configuration.linkage.remembers
        self._remember = [bird for bird in self._birds if not (free or played) and remembers(bird)]
        self._tell_ages = len(self._birds) if free else 0
        self._run = (0, 0)  # run id and epoch that are recorded
        self._next = 0 if saved < 0 else saved + self._every
        self._last = self._last_due(configuration.steps)

    @property
    def ignored(self) -> int:
        """How many messages were left out."""
        return self.ignored_for.total()

    @property
    def saved(self) -> int:
        """The step of the last row that left; -1 before the first."""
        return max(-1, self._next - self._every)

    @property
    def complete(self) -> bool:
        """Whether every row has left."""
        return self._next > self._last

    def begin(self, run_id: int, epoch: int) -> None:
        """Expect states of a new epoch; what was gathered and is not complete comes again.

        Where the run was to be stopped is forgotten: a new clock may not know of it.
        """
        self._run = (run_id, epoch)
        self._rows.clear()
        self._last = self._last_due(self._configuration.steps)

    def end_at(self, step: int) -> None:
        """Expect nothing after `step`: the run is to be stopped there."""
        self._last = min(self._last, self._last_due(step))

    @property
    def waiting_for(self) -> list[int]:
        """The birds of which the next row lacks something."""
        row = self._row(self._next)
        return [
            bird
            for bird in self._birds
            if bird not in row.states
            or (self._next == 0 and bird not in self._wings)
            or (bird in self._remember and bird not in row.memories)
            or (self._tell_ages and bird not in row.ages)
        ]

    def add_wing(self, bird: int, data: bytes) -> list[Row]:
        """Take the BirdWing of `bird`; return the rows that are complete with it."""
        self._wings.setdefault(bird, data)
        return self._complete()

    def add_state(self, bird: int, data: bytes) -> list[Row]:
        """Take a BirdState of `bird`; return the rows that are complete with it."""
        if len(data) != State.size(self._configuration.members):
            return self._ignore(MISSHAPEN)
        run_id, epoch = State.envelope(data)
        if (run_id, epoch) != self._run:
            return self._ignore(FOREIGN if run_id != self._run[0] else STALE)
        step = State.step_of(data)
        if not self._due(step) or bird in self._row(step).states:
            return self._ignore(REPEATED)
        self._row(step).states[bird] = State.opened(data)
        return self._complete()

    def add_memory(self, bird: int, data: bytes) -> list[Row]:
        """Take a BirdMemory of `bird`; return the rows that are complete with it."""
        memory = Memory.decode(data)
        if (memory.run_id, memory.epoch) != self._run:
            return self._ignore(FOREIGN if memory.run_id != self._run[0] else STALE)
        size = self._configuration.linkage.remembers(bird) * self._configuration.members
        if len(memory.data) != size:
            return self._ignore(MISSHAPEN)
        if not self._due(memory.step) or bird in self._row(memory.step).memories:
            return self._ignore(REPEATED)
        self._row(memory.step).memories[bird] = data
        return self._complete()

    def add_ages(self, bird: int, data: bytes) -> list[Row]:
        """Take a BirdAges of `bird`; return the rows that are complete with it."""
        ages = Ages.decode(data)
        if (ages.run_id, ages.epoch) != self._run:
            return self._ignore(FOREIGN if ages.run_id != self._run[0] else STALE)
        if not self._due(ages.step) or bird in self._row(ages.step).ages:
            return self._ignore(REPEATED)
        self._row(ages.step).ages[bird] = data
        return self._complete()

    def add_time(self, data: bytes) -> list[Row]:
        """Take a message of /clock; return the rows that are complete with it."""
        stamp = Time.decode(data).stamp
        row_of_time = self._every * self._configuration.dt * self._configuration.second * 1e9
        step = round(stamp / row_of_time) * self._every
        if not self._due(step) or self._configuration.stamp(step) != stamp:
            return self._ignore(REPEATED)
        self._row(step).time = data
        return self._complete()

    def add_stage(self, bird: int, data: bytes) -> list[Row]:
        """Take a BirdStage of `bird`; return the rows that are complete with it."""
        run_id, step, epoch, _, stage, _ = stage_header(data)
        if (run_id, epoch) != self._run:
            return self._ignore(FOREIGN if run_id != self._run[0] else STALE)
        row = step - step % self._every + self._every
        if not self._due(row):
            return self._ignore(REPEATED) if row <= self._last else []
        self._row(row).stages[STAGES * step + stage, bird] = data
        return self._complete()

    def _last_due(self, end: int) -> int:
        return end - end % self._every

    def _ignore(self, reason: str) -> list[Row]:
        self.ignored_for[reason] += 1
        return []

    def _due(self, step: int) -> bool:
        return step % self._every == 0 and self._next <= step <= self._last

    def _row(self, step: int) -> _Gathering:
        return self._rows.setdefault(step, _Gathering())

    def _complete(self) -> list[Row]:
        rows = []
        birds = self._birds
        timetable = self._configuration.linkage.timetable
        while not self.complete:
            row = self._row(self._next)
            stages = 0
            if self._record_stages and self._next:
                stages = len(birds) * timetable.exchanges(self._next - self._every, self._next)
            if (
                row.time is None
                or (self._next == 0 and len(self._wings) < len(birds))
                or len(row.states) < len(birds)
                or len(row.stages) < stages
                or len(row.memories) < len(self._remember)
                or len(row.ages) < self._tell_ages
            ):
                break
            in_order = [(bird, row.stages[tick, bird]) for tick, bird in sorted(row.stages)]
            states = [row.states[bird] for bird in birds]
            wings = [] if self._next else [self._wings[bird] for bird in birds]
            memories = [row.memories[bird] for bird in self._remember]
            ages = [row.ages[bird] for bird in sorted(row.ages)]
            rows.append(Row(self._next, wings, in_order, row.time, states, memories, ages))
            del self._rows[self._next]
            self._next += self._every
        return rows
