# SPDX-License-Identifier: Apache-2.0
"""The digest of the rows in a bag, from their serialised states."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from flock_sim.analysis.state_digest import StateDigest
from flock_sim.bag.reading.reader import BagReader
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.messages import topics
from flock_sim.messages.state import STATE_STEP_AT, VALUES
from flock_sim.messages.state_layout import (
    fields_of,
    layout_of,
    members_of,
    steps_of,
    times_of,
    values_of,
)
from flock_sim.messages.types import State

Message = tuple[str, int, bytes]
"""Topic, log time in ns, serialised data."""

BATCH = 1 << 16
"""Size of states, in bytes, from which on they are hashed: many at once are faster."""


class RowDigest:
    """The `StateDigest` of rows; a row has the serialised states of bird 1, 2, ... N of one step.

    Memory: `BATCH`, or one row.
    """

    def __init__(self, configuration: FlockConfiguration) -> None:
        """Start before the first row of a flight of `configuration`."""
        birds = range(1, configuration.birds + 1)
        self._birds, self._members = configuration.birds, configuration.members
        self._digest = StateDigest()
        self._hashed = 0  # rows
        self._waiting: list[bytes] = []  # states of whole rows that are not hashed yet
        self._most = max(1, BATCH // State.lengths(self._members).size)
        self._bird_of = {topics.state_topic(bird): bird for bird in birds}

    def add(self, states: Sequence[bytes]) -> None:
        """Add the next row."""
        self._waiting += states
        if len(self._waiting) >= self._most:
            self._hash()

    def watch(self, messages: Iterable[Message]) -> Iterator[Message]:
        """Yield the messages of a bag, and add the rows whose states follow each other in it."""
        row: dict[int, bytes] = {}
        row_step = b""
        for message in messages:
            bird, data = self._bird_of.get(message[0]), message[2]
            if bird is not None and members_of(data) == self._members:
                step = data[STATE_STEP_AT : STATE_STEP_AT + 8]
                if step != row_step:
                    row.clear()
                    row_step = step
                row[bird] = data
                if len(row) == self._birds:
                    self.add([row[each] for each in sorted(row)])
                    row.clear()
            yield message

    @property
    def topics(self) -> list[str]:
        """The topics of the states of bird 1, 2, ... N."""
        return list(self._bird_of)

    @property
    def rows(self) -> int:
        """The number of rows. An exception within `add`, such as Ctrl-C, makes it too small."""
        return self._hashed + len(self._waiting) // self._birds

    @property
    def text(self) -> str | None:
        """The digest as bags have it: "sha256:", 64 hexadecimal digits; None without a row."""
        self._hash()
        return f"sha256:{self._digest.hexdigest()}" if self._hashed else None

    def _hash(self) -> None:
        """Hash the rows that wait; all are left out if a state is not in Flock's layout."""
        states, self._waiting = self._waiting, []
        layout = layout_of(states[0]) if states else None
        if layout is None or layout.members != self._members:
            return
        size = layout.size
        if all(len(state) == size for state in states):
            step, time, values = fields_of(b"".join(states), layout)
        elif all(members_of(state) == self._members for state in states):
            step, time = steps_of(states).astype(np.uint64), times_of(states)
            values = values_of(states, self._members)
        else:
            return
        values = values[:, : len(VALUES)]
        first = slice(None, None, self._birds)  # the state of bird 1 has step and time
        rows = values.reshape(-1, self._birds, *values.shape[1:]).swapaxes(1, 2)
        self._digest.add_rows(step[first].astype(np.int64), time[first], rows)
        self._hashed += len(rows)


def digest_of(bag: BagReader, configuration: FlockConfiguration) -> RowDigest:
    """Return the digest of the rows in a bag. Raises FlockError if the bag is damaged."""
    digest = RowDigest(configuration)
    for _ in digest.watch(bag.messages(digest.topics)):
        pass
    return digest
