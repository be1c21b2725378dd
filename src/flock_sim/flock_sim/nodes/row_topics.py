# SPDX-License-Identifier: Apache-2.0
"""The topics whose messages make up the rows of a bag, and when the recorder looks at each."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from typing import NamedTuple

from rosgraph_msgs.msg import Clock

from flock_interfaces.msg import BirdAges, BirdMemory, BirdStage, BirdState, BirdWing
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.messages import topics
from flock_sim.messages.rejection import MALFORMED
from flock_sim.recording.row_assembler import Row, RowAssembler
from flock_sim.ros.endpoints import DrainedNode, Inlet

LOOK_EVERY = 0.25
"""Time between looks at all topics, in s, also at those on which no message is due. So messages of
other publishers do not fill the queues."""

Add = Callable[[int, bytes], list[Row]]
"""Takes a message of a bird, and returns the rows that it completes."""


class Source(NamedTuple):
    """A topic of one bird, and the function that takes its messages."""

    inlet: Inlet
    add: Add
    bird: int


class RowTopics:
    """`/clock` and the topics of all birds, which a row assembler needs."""

    def __init__(
        self,
        node: DrainedNode,
        configuration: FlockConfiguration,
        assembler: RowAssembler,
        add_wing: Add,
        write: Callable[[list[Row]], None],
        *,
        stages: bool,
        free: bool,
    ) -> None:
        """Subscribe with `node`. `add_wing` takes the wings, `assembler` takes all else.

        `write` gets the rows that a message completes. `stages`: also the Runge-Kutta stages;
        `free`: the topics of a free flight.
        """

        def listen(
            kind: type, topic: Callable[[int], str], add: Add, birds: Iterable[int]
        ) -> list[Source]:
            return [Source(node.subscribe_drained(kind, topic(bird)), add, bird) for bird in birds]

        self._assembler = assembler
        self._write = write
        birds = range(1, configuration.birds + 1)
        remember = [bird for bird in birds if configuration.link_table.remembers(bird)]
        self._times = node.subscribe_drained(Clock, topics.CLOCK_TOPIC)
        self._wings = listen(BirdWing, topics.wing_topic, add_wing, birds)
        self._sources = listen(BirdState, topics.state_topic, assembler.add_state, birds)
        self._states = len(self._sources)
        if free:
            self._sources += listen(BirdAges, topics.ages_topic, assembler.add_ages, birds)
        else:
            self._sources += listen(BirdMemory, topics.memory_topic, assembler.add_memory, remember)
        if stages:
            self._sources += listen(BirdStage, topics.stage_topic, assembler.add_stage, birds)
        self.look_at_all()
        self.expect_all()

    def expect_all(self) -> None:
        """Begin an epoch: the topics of all birds must be discovered again."""
        self._not_found = [source.inlet for source in (*self._wings, *self._sources)]

    def found_all(self) -> bool:
        """Return whether every bird's topics have been discovered, and still exist."""
        lacking = self._not_found
        while lacking and lacking[-1].connected:
            lacking.pop()
        return not (lacking or self.unfound())

    def unfound(self) -> list[str]:
        """Return the names of the nodes with a topic that has not been discovered."""
        sources = (*self._wings, *self._sources)
        inlets = [(source.inlet, topics.bird_name(source.bird)) for source in sources]
        inlets.append((self._times, "the clock"))
        return sorted({who for inlet, who in inlets if not inlet.connected})

    def make_room(self, run_known: bool) -> None:
        """Drop messages that belong to no epoch of ours before they fill a queue.

        Wings are taken once our run is known: each is sent only once, and is of all epochs.
        """
        if self._all_due():
            if run_known:
                for source in self._wings:
                    self._take_all(source)
            for inlet in (self._times, *(source.inlet for source in self._sources)):
                while inlet.take() is not None:
                    pass

    def look_at_all(self) -> None:
        """Let the next `take` look at all topics, from the first bird on."""
        self._place = 0  # index of the next source
        self._look_at = 0.0  # monotonic time of the next look at all topics, in s

    def take(self) -> int:
        """Take the messages that make up rows; return their number.

        No row is complete before every bird has sent its state. So the recorder waits for the next
        bird whose state is missing, and looks at all other topics only every LOOK_EVERY s.
        """
        taken = 0
        while (data := self._times.take()) is not None:
            taken += 1
            self._add(self._assembler.add_time, data)
        thorough = self._all_due()
        if thorough or self._assembler.lacks_wings:
            taken += sum(map(self._take_all, self._wings))
        for _ in self._sources:
            source = self._sources[self._place]
            came = self._take_all(source)
            taken += came
            due = self._place < self._states and self._assembler.lacks_state(source.bird)
            if due and not (came or thorough):
                break
            self._place = (self._place + 1) % len(self._sources)
        return taken

    def _all_due(self) -> bool:
        """Whether the next look at all topics is due."""
        now = time.monotonic()
        due = now >= self._look_at
        if due:
            self._look_at = now + LOOK_EVERY
        return due

    def _take_all(self, source: Source) -> int:
        """Take all messages of one topic; return their number."""
        taken = 0
        while (data := source.inlet.take()) is not None:
            taken += 1
            self._add(source.add, source.bird, data)
        return taken

    def _add(self, add: Callable[..., list[Row]], *what: object) -> None:
        try:
            self._write(add(*what))
        except ValueError:
            self._assembler.ignored_for[MALFORMED] += 1
