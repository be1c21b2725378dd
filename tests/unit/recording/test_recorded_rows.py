# SPDX-License-Identifier: Apache-2.0
"""The last row in a bag is found, however its messages are divided into chunks."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import cast

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from flock_sim.bag.writing.partial_bag import Message, PartialBag
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.launcher.reference_flight import row as row_of
from flock_sim.messages import topics
from flock_sim.messages.types import Memory
from flock_sim.recording.recorded_rows import RecordedRows
from flock_sim.reference.integrator import Reference

CONFIGURATION = FlockConfiguration(birds=2, t_max=2.0, record_every=1, links=("1->2=hold:delay=3",))
STATES = [row_of(CONFIGURATION, state).states for state in Reference(CONFIGURATION).fly()]
MEMORIES = [
    Memory(9, step, 3, 2, np.full(CONFIGURATION.link_table.remembers(2), 1.0)).encode()
    for step in range(3)
]
FIRST, SECOND, MEMORY, CLOCK, GRANT, PUSH, WING = range(7)
PLACE = {
    topics.state_topic(1): FIRST,
    topics.state_topic(2): SECOND,
    topics.memory_topic(2): MEMORY,
    topics.CLOCK_TOPIC: CLOCK,
    topics.GRANT_TOPIC: GRANT,
    topics.PERTURBATION_TOPIC: PUSH,
    topics.wing_topic(1): WING,
}


def said(place: int, step: int) -> Message:
    data = {FIRST: STATES[step][0], SECOND: STATES[step][1], MEMORY: MEMORIES[step]}
    return Message(place, step, data.get(place, b""))


def whole(step: int) -> list[Message]:
    return [said(place, step) for place in (FIRST, SECOND, MEMORY)]


class Chunked:
    """Messages in chunks, as a `PartialBag` gives them. It counts those that are looked at."""

    def __init__(self, chunks: list[list[Message]]) -> None:
        self.chunks = chunks
        self.looked_at = 0

    def messages(self, number: int) -> list[Message]:
        return Counted(self, self.chunks[number])

    def rows(self) -> RecordedRows:
        begun = cast("PartialBag", self)
        return RecordedRows(begun, CONFIGURATION, PLACE, [FIRST, SECOND], [MEMORY])


class Counted(list[Message]):
    def __init__(self, bag: Chunked, values: list[Message]) -> None:
        super().__init__(values)
        self.bag = bag

    def __iter__(self) -> Iterator[Message]:
        for value in super().__iter__():
            self.bag.looked_at += 1
            yield value


def last_row(messages: list[Message]) -> tuple[list[Message], int]:
    """Return the states and memories of the last whole row, and the number of messages up to it.

    A row is a state of bird 1 and, before the next one, the other messages of the same step in
    order. Grants and pushes right after it belong to it.
    """
    row: list[Message] = []
    end = 0
    begins = [at for at, message in enumerate(messages) if message.topic == FIRST]
    for begin, until in pairwise([*begins, len(messages)]):
        wanted = whole(messages[begin].log_time)
        for at in range(begin, until):
            if wanted and messages[at] == wanted[0]:
                wanted.pop(0)
                if not wanted:
                    row, end = whole(messages[begin].log_time), at + 1
    while end < len(messages) and messages[end].topic in (GRANT, PUSH):
        end += 1
    return row, end


parts = st.one_of(
    st.builds(whole, st.integers(0, 2)),
    st.lists(st.builds(said, st.sampled_from(range(7)), st.integers(0, 2)), max_size=4),
)


@given(
    messages=st.lists(parts, max_size=12).map(lambda found: [m for part in found for m in part]),
    cuts=st.lists(st.integers(0, 40), max_size=12),
    whole_chunks=st.integers(0, 13),
)
def test_a_row_is_found_however_it_is_divided(
    messages: list[Message], cuts: list[int], whole_chunks: int
) -> None:
    ends = [*sorted(cuts), len(messages)]
    chunks = [messages[a:b] for a, b in zip([0, *ends], ends, strict=False)]
    known = chunks[:whole_chunks]
    rest = [m for chunk in chunks[whole_chunks:] for m in chunk]
    found = Chunked(known).rows().last_before(len(known), rest)
    row, end = last_row(messages)
    assert [*found.states, *found.memories] == [message.data for message in row]
    before = sum(map(len, known[: found.chunk]))
    assert found.kept == messages[before:end]
    assert found.dropped == len(messages) - end
    assert found.times_dropped == sum(m.topic == CLOCK for m in messages[end:])


def test_no_message_is_looked_at_more_than_a_few_times() -> None:
    rows_cut_off = [[said(FIRST, 1), *[said(CLOCK, 1)] * 5] for _ in range(200)]
    no_row = [[said(CLOCK, 1)] * 6 for _ in range(200)]
    for chunks in (rows_cut_off, no_row, [whole(0), *no_row, *rows_cut_off, *no_row]):
        bag = Chunked(chunks)
        found = bag.rows().last_before(len(chunks), [])
        assert len(found.states) == (2 if chunks[0] == whole(0) else 0)
        assert bag.looked_at <= 4 * sum(map(len, chunks))
