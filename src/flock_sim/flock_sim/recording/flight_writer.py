# SPDX-License-Identifier: Apache-2.0
"""The recording of a flight: its bag, and the rows of the flight as messages in it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import NamedTuple

from flock_sim.bag.reading.reader import BagReader
from flock_sim.bag.topic import Topic
from flock_sim.bag.writing.partial_bag import PartialBag
from flock_sim.bag.writing.put_aside import files_aside
from flock_sim.bag.writing.writer import BagWriter
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.console.arguments import note
from flock_sim.errors import FlockError
from flock_sim.messages import topics
from flock_sim.messages import types as messages
from flock_sim.messages.epochs import in_order
from flock_sim.recording.flight_bag import (
    check_grants,
    checked_push,
    kinds,
    machine_records,
    recorded_push,
    records,
    result_record,
)
from flock_sim.recording.machine import Machine, this_machine
from flock_sim.recording.recorded_rows import RecordedRows
from flock_sim.recording.row_assembler import Row
from flock_sim.recording.row_digest import RowDigest, digest_of


class _Waiting(NamedTuple):
    """The last row that was written, until it is on disk together with its memories."""

    chunk: int | None  # the number of the chunk with its end; None: its memories are not written
    step: int
    states: list[bytes]
    memories: list[bytes]


class Recording:
    """A bag for the rows of one flight; each row lies completely within one chunk.

    The memories of birds are large and needed only to resume a flight. They are written at each
    flush, for the last row only. If birds have memories, a row without them is no checkpoint.
    """

    def __init__(
        self,
        directory: Path,
        configuration: FlockConfiguration,
        *,
        grants: bool,
        stages: bool = False,
        live: bool = False,
        resume: bool = False,
        replace: bool = False,
        factor: float = 0.0,
        machines: Sequence[Machine] = (),
    ) -> None:
        """Begin a bag with the topics of a flight, see `kinds`.

        `resume`: continue an existing bag, after the last row before any damaged or missing row.
        `replace`: an existing bag stays until the first row is on disk. `factor` is the real-time
        factor of a free flight. `machines` are put in the bag before the first row.

        Raises the same errors as `BagWriter`.
        """
        topic_kinds = kinds(configuration, grants, stages, live, factor > 0.0)
        self._configuration = configuration
        self._factor = factor
        self._stamp = 0
        self._saved = -1
        self._checkpoint: list[bytes] = []
        self._memories: list[bytes] = []
        self._waiting: _Waiting | None = None
        self._machines = machines
        self._digest = RowDigest(configuration)
        self.live: dict[int, messages.Push] = {}
        """The recorded pushes that were requested in flight, by number, in order."""
        self.last_grant: messages.Grant | None = None
        """The last grant in a resumed bag."""
        self.bag = BagWriter(
            directory,
            [
                Topic(
                    name,
                    kind.TYPE,
                    durability="transient_local",
                    depth=topics.depth(name, configuration),
                )
                for name, kind in topic_kinds.items()
            ],
            records(configuration, factor),
            resume=resume,
            replace=replace,
        )
        self._place = {name: place for place, name in enumerate(topic_kinds)}
        birds = range(1, configuration.birds + 1)
        self._states = [self._place[topics.state_topic(bird)] for bird in birds]
        self._remembered = [
            self._place[name] for name in map(topics.memory_topic, birds) if name in self._place
        ]
        if self.bag.begun is not None:
            try:
                self._find_checkpoint(self.bag.begun)
            except (FlockError, OSError):
                self.bag.leave()
                raise

    @property
    def saved(self) -> int:
        """The step of the last row that is on disk; -1 if there is none."""
        self._look()
        return self._saved

    @property
    def checkpoint(self) -> list[bytes]:
        """The recorded states of bird 1, 2, ... N in the row of `saved`; [] if there is none."""
        self._look()
        return self._checkpoint

    @property
    def memories(self) -> list[bytes]:
        """The memories in the row of `saved`, of those birds that have one, in order."""
        self._look()
        return self._memories

    def write_row(self, row: Row) -> None:
        """Write all messages of one recorded step, at its simulated time."""
        self._look()
        self._stamp = stamp = self._configuration.stamp(row.step)
        self._keep_machines()
        chunk = self.bag.chunks_safe
        self.bag.write_together((place, stamp, data) for place, data in self._placed(row))
        end = None if row.memories else chunk
        self._waiting = _Waiting(end, row.step, row.states, row.memories)
        self._digest.add(row.states)

    def write(self, topic: str, log_time: int, data: bytes) -> None:
        """Write any message of a flight. Raises KeyError for a topic that is not in the bag."""
        self._keep_machines()
        self.bag.write(topic, log_time, data)

    def write_grant(self, data: bytes) -> None:
        """Write a grant, at the simulated time of the row before it."""
        self.bag.write(topics.GRANT_TOPIC, self._stamp, data)

    def write_perturbation(self, push: messages.Push) -> None:
        """Write a push that was requested in flight, at the simulated time of the push."""
        self.live[push.number] = push
        stamp = self._configuration.stamp(push.step)
        self.bag.write(topics.PERTURBATION_TOPIC, stamp, push.encode())

    def flush(self) -> None:
        """Put all rows on disk, the last one with memories; raises RunFailed on a full disk."""
        self._remember()
        self.bag.flush()

    def close(self) -> None:
        """Flush and complete the bag. Discard it if it is to replace a bag and has no row yet."""
        try:
            self._remember()
            if self.bag.writable:
                self.bag.flush()
                self._look()
        finally:
            if self.bag.replaces:
                self.bag.discard()
            elif not self.closed:
                self.bag.close(result_record(self._state_digest()))

    @property
    def closed(self) -> bool:
        """Whether the bag is closed, so that nothing can be written to it."""
        return self.bag.closed

    def read_digest(self) -> None:
        """Compute the digest of the rows on disk. Raises FlockError if they can't be read."""
        self._digest = RowDigest(self._configuration)
        with BagReader(self.bag.path) as bag:
            self._digest = digest_of(bag, self._configuration)

    def _state_digest(self) -> str | None:
        """Return the digest of the rows on disk; None without rows.

        They are read if they are not the rows that were added: after a full disk, after an
        exception such as Ctrl-C, or if single messages were written.
        """
        if self._digest.rows != self.bag.count(self._states[-1]):
            try:
                self.read_digest()
            except FlockError as error:
                note(f"warning: {error}; so the bag gets no digest of its states")
        return self._digest.text

    def _keep_machines(self) -> None:
        """Write the machines that are not in the bag, once."""
        if self._machines:
            for name, record in machine_records(self._machines, self.bag.metadata).items():
                self.bag.add_metadata(name, record)
            self._machines = ()

    def _remember(self) -> None:
        """Write the memories of the last row, once."""
        waiting = self._waiting
        if waiting is not None and waiting.chunk is None and self.bag.writable:
            chunk = self.bag.chunks_safe
            self.bag.write_together(
                (place, self._stamp, data)
                for place, data in zip(self._remembered, waiting.memories, strict=True)
            )
            self._waiting = waiting._replace(chunk=chunk)

    def _placed(self, row: Row) -> Iterator[tuple[int, bytes]]:
        """Yield the messages of a row in the order of the bag, each with the index of its topic."""
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
        """Update `saved` if the chunk of the waiting row is on disk."""
        waiting = self._waiting
        if waiting is None or waiting.chunk is None or self.bag.chunks_safe <= waiting.chunk:
            return
        self._saved, self._checkpoint = waiting.step, waiting.states
        self._memories = waiting.memories
        self._waiting = None
        self.bag.take_place()

    def _find_checkpoint(self, begun: PartialBag) -> None:
        """Find the last row before any missing row, and drop all messages after it."""
        rows = RecordedRows(begun, self._configuration, self._place, self._states, self._remembered)
        found = rows.last_before(len(begun.chunks), [])
        gap = rows.gap(found, self.bag.count(self._place[topics.CLOCK_TOPIC]))
        if gap is not None:
            found = rows.last_before(*gap)
        if gap is not None or found.dropped:  # the latter: by another writer
            self.bag.cut_back(found.chunk, keep_aside=gap is not None)
            self.bag.write_together(found.kept)
            self.bag.flush()
        if found.states:
            self._saved, self._checkpoint = messages.State.step_of(found.states[0]), found.states
            self._memories = found.memories
            self._stamp = self._configuration.stamp(self._saved)
        with BagReader(self.bag.path) as bag:
            check_grants(bag, self._configuration, self._factor)
            for topic, _, data in bag.messages([topics.PERTURBATION_TOPIC, topics.GRANT_TOPIC]):
                if topic == topics.GRANT_TOPIC:
                    with suppress(ValueError):
                        self.last_grant = messages.Grant.decode(data)
                    continue
                push = recorded_push(bag.path, data, self._configuration)
                self.live[push.number] = push
        for aside in files_aside(self.bag.path):
            self._keep_pushes(aside)
        self.live = {number: self.live[number] for number in in_order(self.live)}

    def _keep_pushes(self, aside: Path) -> None:
        """Write the pushes after the damage in a file put `aside`: they are flown again.

        This is called for all such files, since a kill can come after a file was put aside and
        before its pushes were written.
        """
        with BagReader(aside) as bag:
            for topic, _, data in bag.salvage([]):
                if topic == topics.PERTURBATION_TOPIC:
                    with suppress(FlockError):
                        push = checked_push(data, self._configuration)
                        if push.number not in self.live:
                            self.write_perturbation(push)
        self.bag.flush()


@contextmanager
def recording(
    directory: Path,
    configuration: FlockConfiguration,
    *,
    grants: bool,
    stages: bool = False,
    resume: bool = False,
    replace: bool = False,
    live: bool = False,
    factor: float = 0.0,
    machines: Sequence[Machine] | None = None,
) -> Iterator[Recording]:
    """Yield a recording whose bag is closed, and so complete, however the block ends.

    `resume`: continue an existing bag, or begin a new one if there is none. `replace`: the new bag
    replaces an existing one once its first row is on disk. `live`: with a topic for perturbations
    requested in flight, which a recording with grants always has. `factor`: the real-time factor of
    a free flight. `machines`: those that recorded the flight; None is this one, without ROS.
    """
    run = Recording(
        directory,
        configuration,
        grants=grants,
        stages=stages,
        live=live,
        resume=resume,
        replace=replace,
        factor=factor,
        machines=[this_machine()] if machines is None else machines,
    )
    try:
        if resume:
            with suppress(FlockError):  # it is tried again at the end
                run.read_digest()
        yield run
    finally:
        run.close()


def lay_down(
    directory: Path,
    configuration: FlockConfiguration,
    *,
    grants: bool,
    stages: bool,
    resume: bool = False,
    replace: bool = False,
    factor: float = 0.0,
) -> Recording:
    """Write the beginning of a bag with its configuration, which `recording` can resume.

    `resume` and `replace` are as for `recording`. Returns the recording, which is already closed.

    Raises FlockError if there is already a bag, or the bag can't be written.
    """
    run = Recording(
        directory,
        configuration,
        grants=grants,
        stages=stages,
        resume=resume,
        replace=replace,
        factor=factor,
    )
    run.bag.leave()
    return run
