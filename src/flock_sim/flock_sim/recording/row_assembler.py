# SPDX-License-Identifier: Apache-2.0
"""The assembly of rows: messages come in any order; complete rows go out in order.

A row has all messages of one recorded step: the wings (first row only), the stages of the steps
since the previous row (if stages are recorded), the time, the state of every bird, and the memory
of each bird that has one, or in a free flight the ages. Each row goes out once, so the content of
the bag does not depend on the order in which messages arrive.

Received states carry their run id and epoch; in the bag both are 0. Bytes after the last field of a
message are left out.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from dataclasses import dataclass, field

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.messages.rejection import FOREIGN, IMPOSSIBLE, MISSHAPEN, REPEATED, STALE
from flock_sim.messages.stage_layout import has_layout
from flock_sim.messages.state_layout import Layout, compact, layout_of
from flock_sim.messages.topics import rows_ahead
from flock_sim.messages.types import Ages, Memory, Message, Stage, State, Time, Wing
from flock_sim.physics import formation
from flock_sim.physics.runge_kutta import STAGES

MOST_AHEAD = 16
"""Largest number of rows that are assembled at once, over that of a flock in order (`rows_ahead`).
A played flight has no such limit."""


@dataclass(frozen=True)
class Row:
    """All messages of one recorded step, as they were received."""

    step: int
    wings: list[bytes]
    """The wing of bird 1, 2, ... N, in the first row only."""
    stages: list[tuple[int, bytes]]
    """(bird, message), ordered by step, stage and bird."""
    time: bytes
    states: list[bytes]
    """The state of bird 1, 2, ... N."""
    memories: list[bytes] = field(default_factory=list)
    """The memory of those birds that have one, in order."""
    ages: list[bytes] = field(default_factory=list)
    """The ages of bird 1, 2, ... N, in a free flight."""


class _Gathering:
    """A row that is not complete yet."""

    def __init__(self) -> None:
        self.stages: dict[tuple[int, int], bytes] = {}
        self.time = b""
        self.of: dict[type[Message], dict[int, bytes]] = {State: {}, Memory: {}, Ages: {}}
        """For each type of which a row has one message per bird, those messages by bird."""


class RowAssembler:
    """Assembles the rows of one run. Repeated or unexpected messages are counted and left out."""

    def __init__(
        self,
        configuration: FlockConfiguration,
        record_stages: bool = False,
        saved: int = -1,
        free: bool = False,
        played: bool = False,
    ) -> None:
        """Expect every recorded step of `configuration` after `saved`; `free`: of a free flight.

        In a free flight, birds send ages and no memories. In a `played` flight birds send no
        memories, and their states have run id 0, as in a bag.
        """
        self.ignored_for: Counter[str] = Counter()
        """Number of messages that were left out, by reason."""
        self._configuration = configuration
        self._birds = range(1, configuration.birds + 1)
        self._every = configuration.record_every
        self._record_stages = record_stages
        self._rows: defaultdict[int, _Gathering] = defaultdict(_Gathering)
        self._wings: dict[int, bytes] = {}
        remembers = configuration.link_table.remembers
        self._remember = [bird for bird in self._birds if not (free or played) and remembers(bird)]
        self._tell_ages = len(self._birds) if free else 0
        rows = None if played else MOST_AHEAD * rows_ahead(configuration)
        self._ahead = configuration.steps if rows is None else rows * self._every
        self._members = configuration.members
        # A played flight may have laws that this process does not have.
        self._numbers = None if played else configuration.forcing_table.states
        self._run = (0, 0)  # run id and epoch that are recorded
        self._next = 0 if saved < 0 else saved + self._every
        self._last = self._last_due(configuration.steps)

    @property
    def ignored(self) -> int:
        """Number of messages that were left out."""
        return self.ignored_for.total()

    @property
    def saved(self) -> int:
        """The step of the last row that went out; -1 before the first."""
        return max(-1, self._next - self._every)

    @property
    def complete(self) -> bool:
        """Whether every row has gone out."""
        return self._next > self._last

    def complete_to(self, end: int) -> bool:
        """Whether every row up to step `end` has gone out."""
        return self._next > self._last_due(end)

    def begin(self, run_id: int, epoch: int) -> None:
        """Expect states of a new epoch. Incomplete rows are dropped: their messages come again.

        The step set by `end_at` is dropped too, since a new clock may not know it.
        """
        self._run = (run_id, epoch)
        self._rows.clear()
        self._last = self._last_due(self._configuration.steps)

    def end_at(self, step: int) -> None:
        """Expect no row after `step`: the run will be stopped there."""
        self._last = min(self._last, self._last_due(step))

    @property
    def waiting_for(self) -> list[int]:
        """The birds from which the next row lacks a message."""
        row = self._rows[self._next]
        return [
            bird
            for bird in self._birds
            if bird not in row.of[State]
            or (self._next == 0 and bird not in self._wings)
            or (bird in self._remember and bird not in row.of[Memory])
            or (self._tell_ages and bird not in row.of[Ages])
        ]

    @property
    def lacks_wings(self) -> bool:
        """Whether the next row lacks the wing of a bird."""
        return self._next == 0 and len(self._wings) < len(self._birds)

    def lacks_state(self, bird: int) -> bool:
        """Whether the next row lacks the state of `bird`."""
        row = self._rows.get(self._next)
        return row is None or bird not in row.of[State]

    def add_wing(self, bird: int, data: bytes) -> list[Row]:
        """Take the BirdWing of `bird`; return the rows that are complete with it."""
        wing = Wing.decode(data)
        if wing.bird != bird:
            return self._ignore(IMPOSSIBLE)
        self._wings.setdefault(bird, wing.encode())
        return self._complete()

    def add_state(self, bird: int, data: bytes) -> list[Row]:
        """Take a BirdState of `bird`; return the rows that are complete with it."""
        layout = layout_of(data)
        if layout is None:
            data = compact(data)
            layout = layout_of(data)
        if layout is None or layout.members != self._members or not self._fits(layout):
            return self._ignore(MISSHAPEN)
        run = State.envelope(data)
        if run != self._run:
            return self._ignore_run(run)
        step, time = State.step_and_time_of(data)
        if not abs(time - self._configuration.time(step)) < self._configuration.dt:
            return self._ignore(IMPOSSIBLE)
        return self._take(State, step, bird, State.opened(data))

    def add_memory(self, bird: int, data: bytes) -> list[Row]:
        """Take a BirdMemory of `bird`; return the rows that are complete with it."""
        memory = Memory.decode(data)
        run = memory.run_id, memory.epoch
        if run != self._run:
            return self._ignore_run(run)
        size = self._configuration.link_table.remembers(bird) * self._configuration.members
        if len(memory.data) != size:
            return self._ignore(MISSHAPEN)
        return self._take(Memory, memory.step, bird, memory.encode(), memory.bird)

    def add_ages(self, bird: int, data: bytes) -> list[Row]:
        """Take a BirdAges of `bird`; return the rows that are complete with it."""
        ages = Ages.decode(data)
        run = ages.run_id, ages.epoch
        if run != self._run:
            return self._ignore_run(run)
        configuration = self._configuration
        heard = formation.neighbours(bird, configuration.birds, configuration.coupling)
        if any(len(values) != len(heard) for values in (ages.age, ages.age_max, ages.behind)):
            return self._ignore(MISSHAPEN)
        return self._take(Ages, ages.step, bird, ages.encode(), ages.bird)

    def add_time(self, data: bytes) -> list[Row]:
        """Take a message of /clock; return the rows that are complete with it."""
        time = Time.decode(data)
        stamp = time.stamp
        row_of_time = self._every * self._configuration.dt * self._configuration.second * 1e9
        step = round(stamp / row_of_time) * self._every
        if not self._due(step) or self._configuration.stamp(step) != stamp:
            return []  # a step in between, or the time of another flight: it has no run id
        self._rows[step].time = time.encode()
        return self._complete()

    def add_stage(self, bird: int, data: bytes) -> list[Row]:
        """Take a BirdStage of `bird`; return the rows that are complete with it."""
        run_id, step, epoch, sender, stage, _ = Stage.header(data)
        if (run_id, epoch) != self._run:
            return self._ignore_run((run_id, epoch))
        if not has_layout(data, self._members):
            return self._ignore(MISSHAPEN)
        schedule, tick = self._configuration.link_table.exchange_schedule, STAGES * step + stage
        if sender != bird or stage >= STAGES or not schedule.due(tick):
            return self._ignore(IMPOSSIBLE)
        row = step - step % self._every + self._every
        if not self._due(row):
            return self._ignore(REPEATED) if row <= self._last else []
        self._rows[row].stages[tick, bird] = data
        return self._complete()

    def _fits(self, layout: Layout) -> bool:
        """Whether a state has all arrays, and as many numbers of forcing as the flight."""
        if layout.forcing is None:
            return False
        numbers, rest = divmod(layout.forcing, self._members)
        return not rest and self._numbers in (None, numbers)

    def _last_due(self, end: int) -> int:
        return end - end % self._every

    def _ignore(self, reason: str) -> list[Row]:
        self.ignored_for[reason] += 1
        return []

    def _ignore_run(self, run: tuple[int, int]) -> list[Row]:
        """Ignore a message of `run`, its run id and its epoch."""
        return self._ignore(STALE if run[0] == self._run[0] else FOREIGN)

    def _take(
        self, kind: type[Message], step: int, bird: int, data: bytes, sender: int | None = None
    ) -> list[Row]:
        """Take a message of which a row has one per bird; return the rows that are complete.

        `sender` is the bird that the message names, if it names one.
        """
        if sender not in (None, bird):
            return self._ignore(IMPOSSIBLE)
        taken = self._rows[step].of[kind] if self._due(step) else None
        if taken is None or bird in taken:
            return self._ignore(REPEATED)
        taken[bird] = data
        return self._complete()

    def _due(self, step: int) -> bool:
        last = min(self._last, self._next + self._ahead)
        return step % self._every == 0 and self._next <= step <= last

    def _complete(self) -> list[Row]:
        rows = []
        birds = self._birds
        while not self.complete and self._has_all(row := self._rows[self._next]):
            in_order = [(bird, row.stages[tick, bird]) for tick, bird in sorted(row.stages)]
            states = [row.of[State][bird] for bird in birds]
            wings = [] if self._next else [self._wings[bird] for bird in birds]
            memories = [row.of[Memory][bird] for bird in self._remember]
            ages = [row.of[Ages][bird] for bird in sorted(row.of[Ages])]
            rows.append(Row(self._next, wings, in_order, row.time, states, memories, ages))
            del self._rows[self._next]
            self._next += self._every
        return rows

    def _has_all(self, row: _Gathering) -> bool:
        """Whether the next row lacks nothing. The states are the most messages: they come first."""
        birds = len(self._birds)
        return (
            len(row.of[State]) >= birds
            and row.time != b""
            and (self._next > 0 or len(self._wings) >= birds)
            and len(row.stages) >= self._stages_due()
            and len(row.of[Memory]) >= len(self._remember)
            and len(row.of[Ages]) >= self._tell_ages
        )

    def _stages_due(self) -> int:
        """Return the number of stage messages of the next row."""
        if not (self._record_stages and self._next):
            return 0
        schedule = self._configuration.link_table.exchange_schedule
        return len(self._birds) * schedule.exchanges(self._next - self._every, self._next)
