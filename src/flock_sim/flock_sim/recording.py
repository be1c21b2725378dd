# SPDX-License-Identifier: Apache-2.0
"""A flight's bag: which topics it has, and how a row of the flight becomes messages in it."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from flock_sim import __version__
from flock_sim.bag.begun import Begun, Message
from flock_sim.bag.reader import BagReader
from flock_sim.bag.topic import Topic
from flock_sim.bag.writer import BagWriter
from flock_sim.core import messages, topics
from flock_sim.core.configuration import FlockConfiguration
from flock_sim.core.ledger import Row
from flock_sim.core.perturbation import Perturbation
from flock_sim.errors import FlockError

CONFIGURATION_RECORD = "flock"
"""The MCAP metadata record that holds the configuration, each value as JSON."""

FREE_RECORD = "free"
"""The one that a free flight has besides, with its real-time factor as JSON."""

FACTOR = "real_time_factor"


class _Waiting(NamedTuple):
    """The last row that was written, as long as it may not be on disk, memories and all."""

    chunk: int | None  # the number of the chunk that its end is in; None: it lacks memories
    step: int
    states: list[bytes]
    memories: list[bytes]


class Recording:
    """A bag that takes the rows of one flight; each row is in one chunk, as a whole.

    What birds remember is much, and needed only to go on: it is written when rows are made safe,
    for the last of them. Where birds have memories, a row without them is no checkpoint.
    """

    def __init__(
        self,
        directory: Path,
        configuration: FlockConfiguration,
        kinds: Mapping[str, type[messages.Message]],
        *,
        resume: bool = False,
        factor: float = 0.0,
    ) -> None:
        """Begin a bag; `kinds` gives the message of each topic, in the order of the bag.

        `resume`: go on with the bag that is there. `factor` is the real-time factor of a free
        flight. Raises what `BagWriter` does.
        """
        self._configuration = configuration
        self._stamp = 0
        self._saved = -1
        self._checkpoint: list[bytes] = []
        self._memories: list[bytes] = []
        self._waiting: _Waiting | None = None
        self.live: dict[int, Perturbation] = {}
        """The pushes asked for in flight that are recorded, by number."""
        self.bag = BagWriter(
            directory,
            [
                Topic(
                    name,
                    kind.TYPE,
                    durability="transient_local",
                    depth=topics.depth(name, configuration),
                )
                for name, kind in kinds.items()
            ],
            {CONFIGURATION_RECORD: configuration_record(configuration)}
            | ({FREE_RECORD: {FACTOR: json.dumps(factor)}} if factor else {}),
            resume=resume,
        )
        self._place = {name: place for place, name in enumerate(kinds)}
        birds = range(1, configuration.birds + 1)
        self._states = [self._place[topics.state_topic(bird)] for bird in birds]
        self._remembered = [
            self._place[name] for name in map(topics.memory_topic, birds) if name in self._place
        ]
        if self.bag.begun is not None:
            try:
                self._find_checkpoint(self.bag.begun)
            except FlockError:
                self.bag.leave()
                raise

    @property
    def saved(self) -> int:
        """The step of the last row that is on disk; -1 where none is."""
        self._look()
        return self._saved

    @property
    def checkpoint(self) -> list[bytes]:
        """The states of bird 1, 2, ... N in that row, as they are recorded; [] where none is."""
        self._look()
        return self._checkpoint

    @property
    def memories(self) -> list[bytes]:
        """What goes with it: the memories of those birds that have one, in order."""
        self._look()
        return self._memories

    def write_row(self, row: Row) -> None:
        """Write everything of one recorded step, at its simulated time."""
        self._look()
        self._stamp = stamp = self._configuration.stamp(row.step)
        chunk = self.bag.chunks_safe
        self.bag.write_together((place, stamp, data) for place, data in self._placed(row))
        end = None if row.memories else chunk
        self._waiting = _Waiting(end, row.step, row.states, row.memories)

    def write_grant(self, data: bytes) -> None:
        """Write a grant, at the simulated time of the row before it."""
        self.bag.write(topics.GRANT_TOPIC, self._stamp, data)

    def write_perturbation(self, push: messages.Push) -> None:
        """Write a push that was asked for in flight, at the simulated time at which it happens."""
        self.live[push.number] = push.perturbation
        stamp = self._configuration.stamp(push.step)
        self.bag.write(topics.PERTURBATION_TOPIC, stamp, push.encode())

    def flush(self) -> None:
        """Put all rows on disk, the last one with memories; raises RunFailed without room."""
        self._remember()
        self.bag.flush()

    def close(self) -> None:
        """Do the same, and complete the bag."""
        try:
            self._remember()
        finally:
            self.bag.close()

    def _remember(self) -> None:
        """Write the memories that go with the last row, once."""
        waiting = self._waiting
        if waiting is not None and waiting.chunk is None and self.bag.writable:
            chunk = self.bag.chunks_safe
            self.bag.write_together(
                (place, self._stamp, data)
                for place, data in zip(self._remembered, waiting.memories, strict=True)
            )
            self._waiting = waiting._replace(chunk=chunk)

    def _placed(self, row: Row) -> Iterator[tuple[int, bytes]]:
        """Yield the messages of a row in the order of the bag, each with its topic's place."""
        place = self._place
        for bird, data in enumerate(row.wings, start=1):
            yield place[topics.wing_topic(bird)], data
        for bird, data in row.stages:
            yield place[topics.stage_topic(bird)], data
        yield place[topics.CLOCK_TOPIC], row.time
        for bird, data in enumerate(row.ages, start=1):
            yield place[topics.ages_topic(bird)], data
        yield from zip(self._states, row.states, strict=True)

    def _look(self) -> None:
        """Take note of the row that waits once its chunk is on disk, whoever put it there."""
        waiting = self._waiting
        if waiting is None or waiting.chunk is None or self.bag.chunks_safe <= waiting.chunk:
            return
        self._saved, self._checkpoint = waiting.step, waiting.states
        self._memories = waiting.memories
        self._waiting = None

    def _find_checkpoint(self, begun: Begun) -> None:
        """Find the last row of a bag that is gone on with, and drop what follows it."""
        number = len(begun.chunks)
        held: list[Message] = []
        end, states, memories = 0, list[bytes](), list[bytes]()
        while number and not states:
            number -= 1
            held = begun.messages(number) + held
            end, states, memories = self._last_row(held)
        if end < len(held):  # not by us: some other writer ended a chunk within a row
            self.bag.cut_back(number)
            self.bag.write_together(held[:end])
            self.bag.flush()
        if states:
            self._saved, self._checkpoint = messages.State.step_of(states[0]), states
            self._memories = memories
            self._stamp = self._configuration.stamp(self._saved)
        with BagReader(self.bag.directory) as bag:
            for _, _, data in bag.messages([topics.PERTURBATION_TOPIC]):
                push = messages.Push.decode(data)
                self.live[push.number] = push.perturbation

    def _last_row(self, held: Sequence[Message]) -> tuple[int, list[bytes], list[bytes]]:
        """Return the end in `held` of the last whole row with what follows it, and what it says.

        That are its states, and the memories that go with it.
        """
        places = [*self._states, *self._remembered]
        birds = len(self._states)
        order = {place: k for k, place in enumerate(places)}
        between = {
            self._place.get(name) for name in (topics.GRANT_TOPIC, topics.PERTURBATION_TOPIC)
        }
        end, whole = 0, list[bytes]()
        row: list[bytes] = []
        step = -1
        for at, (place, _, data) in enumerate(held):
            k = order.get(place)
            if k is not None:
                said = (messages.State if k < birds else messages.Memory).step_of(data)
                if k == 0:
                    row, step = [], said
                if k == len(row) and said == step:
                    row.append(data)
                if len(row) == len(places):
                    end, whole, row = at + 1, row, []
            elif place in between and at == end:
                end = at + 1
        return end, whole[:birds], whole[birds:]


@contextmanager
def recording(
    directory: Path,
    configuration: FlockConfiguration,
    *,
    grants: bool,
    stages: bool = False,
    resume: bool = False,
    live: bool = False,
    factor: float = 0.0,
) -> Iterator[Recording]:
    """Give a recording whose bag is closed, and so complete, however the block ends.

    `resume`: it goes on with the bag that is there, or begins one if there is none. `live`: with
    perturbations that are asked for in flight, which one with grants has anyway. `factor`: the
    real-time factor of a free flight.
    """
    kinds = _kinds(configuration, grants, stages, live, factor > 0.0)
    run = Recording(directory, configuration, kinds, resume=resume, factor=factor)
    try:
        yield run
    finally:
        run.close()


def lay_down(
    directory: Path,
    configuration: FlockConfiguration,
    *,
    grants: bool,
    stages: bool,
    factor: float = 0.0,
) -> None:
    """Have the beginning of a bag in `directory`, its configuration, for `recording` to resume.

    Raises FlockError where there is one already or it can't be written.
    """
    kinds = _kinds(configuration, grants, stages, free=factor > 0.0)
    Recording(directory, configuration, kinds, factor=factor).bag.leave()


def has_stages(bag: BagReader) -> bool:
    """Tell whether a flight was recorded with its Runge-Kutta stages."""
    return topics.stage_topic(1) in bag.topics


def _kinds(
    configuration: FlockConfiguration,
    grants: bool,
    stages: bool,
    live: bool = False,
    free: bool = False,
) -> dict[str, type[messages.Message]]:
    """Return the message of each topic, in the order of the bag."""
    birds = range(1, configuration.birds + 1)
    kinds: dict[str, type[messages.Message]] = {topics.CLOCK_TOPIC: messages.Time}
    if grants:
        kinds[topics.GRANT_TOPIC] = messages.Grant
    if grants or live:
        kinds[topics.PERTURBATION_TOPIC] = messages.Push
    kinds |= {topics.wing_topic(bird): messages.Wing for bird in birds}
    kinds |= {topics.state_topic(bird): messages.State for bird in birds}
    if free:
        kinds |= {topics.ages_topic(bird): messages.Ages for bird in birds}
    elif grants:  # what can be gone on with
        linkage = configuration.linkage
        remember = [bird for bird in birds if linkage.remembers(bird)]
        kinds |= {topics.memory_topic(bird): messages.Memory for bird in remember}
    if stages:
        kinds |= {topics.stage_topic(bird): messages.Stage for bird in birds}
    return kinds


def configuration_record(configuration: FlockConfiguration) -> dict[str, str]:
    """Return the configuration as text, key by key, with the version that flew it.

    Where nothing is said of links, nothing is written of them: such bags are as they always were.
    """
    values: dict[str, Any] = {**configuration.parameters(), "flock_version": __version__}
    if not configuration.links:
        del values["links"]
    return {key: json.dumps(value) for key, value in values.items()}


def configuration_of(record: Mapping[str, str]) -> FlockConfiguration:
    """Return the configuration in a bag's record. Raises FlockError or ValueError otherwise."""
    values = {key: json.loads(value) for key, value in record.items()}
    values.pop("flock_version", None)
    return FlockConfiguration.from_parameters(values)
