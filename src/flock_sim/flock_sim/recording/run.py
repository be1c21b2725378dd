# SPDX-License-Identifier: Apache-2.0
"""A recorded flight, read back from its bag row by row."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from itertools import islice
from pathlib import Path
from typing import Self, TypeVar

import numpy as np

from flock_sim import __version__
from flock_sim.analysis.flight_verdict import flight_verdicts
from flock_sim.analysis.metrics import Metrics, measure
from flock_sim.analysis.time_means import Averaging, TimeMeans
from flock_sim.analysis.verdict import Verdicts
from flock_sim.bag.reading.reader import BagReader
from flock_sim.configuration.perturbation import Perturbation
from flock_sim.errors import FlockError
from flock_sim.messages import topics
from flock_sim.messages import types as messages
from flock_sim.messages.epochs import in_order
from flock_sim.messages.state import VALUES
from flock_sim.messages.state_layout import members_of, steps_of, values_of
from flock_sim.outside import json_text
from flock_sim.physics import formation
from flock_sim.physics.arrays import FloatArray
from flock_sim.physics.flock_state import FlockState
from flock_sim.recording.flight_bag import (
    CONFIGURATION_RECORD,
    recorded_configuration,
    recorded_digest,
    recorded_factor,
    recorded_machines,
    recorded_push,
)
from flock_sim.recording.foreign_flight import needed_repair
from flock_sim.recording.machine import Machine
from flock_sim.recording.own_parts import (
    OwnPart,
    note_link_models,
    own_laws,
    own_link_models,
    recorded_parts,
    unknown_link_models,
)

BLOCK = 4096
"""Number of states that are read at once."""

LATEST = 2.0**64
"""End of the times that a bag can hold, in ns."""

SPARSE = 50
"""Mean number of rows between wanted ones above which each of them is sought in the bag."""

Message = TypeVar("Message", bound=messages.Message)


class Run:
    """A bag of Flock's.

    `configuration` is that of the flight; `missing` is None, or one line on the missing parts of
    the bag; `bag` gives the messages themselves.

        with Run("runs/demo") as run:
            print(run.at().speed)
    """

    def __init__(self, path: str | Path) -> None:
        """Open the bag at `path`. Raises FlockError if it is missing, empty or foreign."""
        self.path = Path(path)
        self.bag = BagReader(self.path)
        if repair := needed_repair(self.bag):
            self.bag.close()
            raise FlockError(repair)
        note_link_models(recorded_parts(self.bag.records))
        try:
            self.configuration = recorded_configuration(self.bag)
        except (KeyError, ValueError, FlockError) as error:
            self.bag.close()
            if unknown := self._unknown_link_models():
                raise FlockError(
                    f"{self.path}: its link model {', '.join(unknown)} is not in Flock "
                    f"{__version__}, and the bag contains only the name; register the model first, "
                    "in a Python process that calls the tool (docs/extending.md)"
                ) from error
            torn = self.bag.missing and not self.bag.topics
            why = "it is cut off or damaged at its beginning, which describes its content"
            raise FlockError(
                f"{self.path}: not a bag of Flock's "
                f"({why if torn else f'no configuration that can be read: {error}'}); "
                "name a directory that fly or reference wrote"
            ) from error

        self.missing = self.bag.missing or self._cut_short()

    def _unknown_link_models(self) -> list[str]:
        """Return the recorded link models that this process lacks; none if it can't be read."""
        with suppress(KeyError, TypeError, ValueError, FlockError):
            links = json_text.parse(self.bag.metadata(CONFIGURATION_RECORD)["links"])
            return unknown_link_models(links)
        return []

    def _cut_short(self) -> str | None:
        """Return a line on a flight that ended early with a whole bag; None if it is complete."""
        flown = self.configuration
        last = flown.steps - flown.steps % flown.record_every
        reached = self._reached(flown.stamp(last))
        if reached is None or reached >= flown.stamp(last):
            return None
        time = reached / (flown.second * 1e9)
        return f"{self.path}: the flight was ended at t = {time:.6g} of {flown.t_max:g}"

    def _reached(self, end: int) -> int | None:
        """Return the simulated time, in ns, that the flight reached; `end` is that of its end.

        Pushes may have been recorded with later times.
        """
        counts = self.bag.message_counts
        if not counts or not counts.get(topics.PERTURBATION_TOPIC):
            return self.bag.last_time
        clock = [topics.CLOCK_TOPIC]
        try:
            if next(self.bag.messages(clock, start=end), None):
                return end
            return max((time for _, time, _ in self.bag.messages(clock)), default=None)
        except FlockError:  # a later read raises it again
            return self.bag.last_time

    def close(self) -> None:
        """Close the bag; a second call does nothing."""
        self.bag.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    @property
    def real_time_factor(self) -> float:
        """The real-time factor of a free flight; 0 for a flight in lockstep.

        Raises FlockError if it can't be read.
        """
        return recorded_factor(self.bag)

    @property
    def state_digest(self) -> str | None:
        """The digest of all states that the bag holds as a record; None if it holds none."""
        return recorded_digest(self.bag)

    @property
    def own_parts(self) -> list[OwnPart]:
        """The parts of the flight that are not in Flock, and of which the bag has only names."""
        recorded = recorded_parts(self.bag.records)
        known = {(part.kind, part.name) for part in recorded}
        named = [*own_laws(self.configuration), *own_link_models(self.configuration)]
        return [*recorded, *(part for part in named if (part.kind, part.name) not in known)]

    @property
    def machines(self) -> list[Machine]:
        """The machines that recorded the flight, in order; none for bags from before."""
        return recorded_machines(self.bag.records)

    def ages(self) -> Iterator[tuple[int, messages.Ages]]:
        """Yield (bird, ages of its data) in the order of the bag; nothing if not flown freely.

        Raises FlockError if the number of ages is not the number of neighbours of the bird.
        """
        flown = self.configuration
        bird_of = self._bird_of(topics.ages_topic)
        for topic, _, data in self.bag.messages(topics=list(bird_of)):
            bird, ages = bird_of[topic], self._decode(messages.Ages, topic, data)
            links = len(formation.neighbours(bird, flown.birds, flown.coupling))
            if any(len(values) != links for values in (ages.age, ages.age_max, ages.behind)):
                raise FlockError(
                    f"{self.path}: {topic}: the length does not match {links} neighbours; "
                    "take another copy of the bag"
                )
            yield bird, ages

    def states(self, start: int | None = None) -> Iterator[tuple[int, messages.State]]:
        """Yield (bird, state) in the order of the bag, from simulated time `start` in ns."""
        bird_of = self._bird_of(topics.state_topic)
        for topic, _, data in self.bag.messages(topics=list(bird_of), start=start):
            yield bird_of[topic], self.decode(topic, data)

    def decode(self, topic: str, data: bytes) -> messages.State:
        """Return the state in `data` of this bag. Raises FlockError if it is not a state."""
        return self._decode(messages.State, topic, data)

    def _decode(self, kind: type[Message], topic: str, data: bytes) -> Message:
        try:
            return kind.decode(data)
        except ValueError as error:
            raise FlockError(
                f"{self.path}: {topic}: {error}; take another copy of the bag"
            ) from error

    def _bird_of(self, topic_of: Callable[[int], str]) -> dict[str, int]:
        return {topic_of(bird): bird for bird in range(1, self.configuration.birds + 1)}

    def wings(self) -> dict[int, FloatArray]:
        """Return the span ratios of each bird, shape (members,), from its wing message."""
        bird_of = self._bird_of(topics.wing_topic)
        found = self.bag.messages(topics=list(bird_of), end=1)
        return {
            bird_of[topic]: self._decode(messages.Wing, topic, data).span_ratio
            for topic, _, data in found
        }

    def perturbations(self) -> list[Perturbation]:
        """Return the perturbations requested in flight, in order of number.

        Those of the configuration are not included. Raises FlockError if one does not fit the
        flight, or two different ones have the same number.
        """
        members = self.configuration.members
        found: dict[int, list[Perturbation]] = {}
        for _, _, data in self.bag.messages([topics.PERTURBATION_TOPIC]):
            message = recorded_push(self.path, data, self.configuration)
            number, pushes = message.number, message.each(members)
            if found.setdefault(number, pushes) != pushes:
                raise FlockError(
                    f"{self.path}: perturbation {number} is both '{found[number][0]}' and "
                    f"'{pushes[0]}'; remove the second one with ./flock repair"
                )
        return [push for number in in_order(found) for push in found[number]]

    def snapshots(self, start: int | None = None) -> Iterator[FlockState]:
        """Yield every complete recorded step, from simulated time `start` in ns."""
        return self._complete(self.states(start))

    def snapshots_at(self, steps: Sequence[int]) -> Iterator[FlockState]:
        """Yield those of `steps`, which ascend, that are recorded completely.

        States at other steps are not decoded.
        """
        configuration = self.configuration
        rows = (steps[-1] - steps[0]) // configuration.record_every
        if len(steps) > 1 and rows > SPARSE * len(steps) and self.bag.message_counts is not None:
            for step in steps:  # each is found by the summary of the bag
                yield from self.snapshots_at([step])
            return
        bird_of = self._bird_of(topics.state_topic)
        stamps = {configuration.stamp(step) for step in steps}
        found = self.bag.messages(list(bird_of), min(stamps), max(stamps) + 1)
        wanted = (
            (bird_of[topic], self.decode(topic, data))
            for topic, time, data in found
            if time in stamps
        )
        yield from (state for state in self._complete(wanted) if state.step in steps)

    def _complete(self, states: Iterable[tuple[int, messages.State]]) -> Iterator[FlockState]:
        """Yield the flock at every step of which the states of all birds follow each other."""
        row: dict[int, messages.State] = {}
        for bird, state in states:
            if row and state.step != next(iter(row.values())).step:
                row = {}
            row[bird] = state
            if len(row) == self.configuration.birds:
                yield self._snapshot(row)
                row = {}

    def at(self, time: float | None = None) -> FlockState:
        """Return the flock at `time` in b / U_min; at the last recorded step if None.

        Raises FlockError if no step was recorded at this time.
        """
        configuration = self.configuration
        if time is None:
            return self._last()
        every = configuration.record_every * configuration.dt
        if not np.isfinite(time):
            raise FlockError(f"time {time}: must be finite; leave it out for the last recorded one")
        within = min(max(time, -every), configuration.t_max + every)  # beyond, there are no stamps
        step = round(within / every) * configuration.record_every
        if abs(configuration.time(step) - time) <= 1e-9 * max(every, abs(time)):
            for snapshot in self.snapshots(configuration.stamp(step)):
                if snapshot.step == step:
                    return snapshot
                break
        last = self._last().time
        asked = repr(float(time)).removesuffix(".0")
        raise FlockError(
            f"time {asked}: not recorded; multiples of {every:.12g} up to {last:.12g} are"
        )

    def metrics(self, time: float | None = None) -> Metrics:
        """Return the metrics at `time` in b / U_min; at the last recorded step if None."""
        return measure(self.configuration, self.at(time))

    def verdicts(self, time: float | None = None) -> Verdicts:
        """Return the verdicts on the flight up to `time` in b / U_min; to its end if None."""
        pushes = [*self.configuration.pushes, *self.perturbations()]
        return flight_verdicts(self, self.at(time), pushes)

    def time_means(self, until: float, over: float | None = None) -> TimeMeans:
        """Return the means over the time `over` up to the recorded time `until`, in b / U_min.

        `over` None is a tenth of the time up to `until`. Raises FlockError as `Averaging`, and if a
        state is not as Flock writes it.
        """
        flown = self.configuration
        averaging = Averaging(flown, until, over)
        bird_of = self._bird_of(topics.state_topic)
        start, end = flown.stamp(averaging.first), flown.stamp(averaging.last) + 1
        messages_of_states = self.bag.messages(list(bird_of), start, end)
        while block := list(islice(messages_of_states, BLOCK)):
            states = [self._as_written(topic, data) for topic, _, data in block]
            averaging.add(
                np.array([bird_of[topic] - 1 for topic, _, _ in block]),
                steps_of(states),
                values_of(states, flown.members)[:, len(VALUES) :],
            )
        return averaging.result()

    def _as_written(self, topic: str, data: bytes) -> bytes:
        """Return an encoded state if it has the layout and the members of this flight."""
        if members_of(data) == self.configuration.members:
            return data
        raise FlockError(
            f"{self.path}: {topic}: a state is not as Flock writes it for "
            f"{self.configuration.members} members; take another copy of the bag"
        )

    def _last(self) -> FlockState:
        """Return the last complete row; in a bag that was cut short, a few rows may follow it."""
        end = self.bag.last_time
        back, more = 0, self.configuration.stamp(64 * self.configuration.record_every) + 1
        while end is not None:
            last = deque(self.snapshots(max(end - back, 0)), maxlen=1)
            if last:
                return last[0]
            if back >= end:
                break
            back, more = back + more, 2 * more
        raise FlockError(f"{self.path}: no recorded step is complete; fly again")

    def _snapshot(self, row: dict[int, messages.State]) -> FlockState:
        states = [row[bird] for bird in sorted(row)]
        members = self.configuration.members
        if any(len(getattr(state, name)) != members for state in states for name in VALUES):
            raise FlockError(
                f"{self.path}: the states of step {states[0].step} have not the {members} "
                "members of the configuration; take another copy of the bag"
            )
        found = FlockState.of(states)
        for time in (self.configuration.time(found.step), found.time):
            if not time * self.configuration.second * 1e9 < LATEST:
                raise FlockError(
                    f"{self.path}: a state has step {found.step} and time {found.time:g}, which"
                    " can't be recorded; take another copy of the bag"
                )
        return found
