# SPDX-License-Identifier: Apache-2.0
"""The rows in a resumed bag: the last one, and gaps before it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import chain
from typing import NamedTuple

from flock_sim.bag.writing.partial_bag import Message, PartialBag
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.messages import topics
from flock_sim.messages import types as messages


class Found(NamedTuple):
    """The last whole row of a resumed bag, and its place."""

    chunk: int  # the number of the chunk in which it begins
    kept: list[Message]  # of this chunk on, up to the grants and pushes that follow the row
    dropped: int  # messages after them
    times_dropped: int  # those among them on /clock
    states: list[bytes]
    memories: list[bytes]


class RecordedRows:
    """Finds rows. If birds have memories, a flight can't resume from a row without them."""

    def __init__(
        self,
        begun: PartialBag,
        configuration: FlockConfiguration,
        place: Mapping[str, int],
        states: Sequence[int],
        remembered: Sequence[int],
    ) -> None:
        """Search the bag `begun`; `place` has the index of each topic, from 0.

        `states` and `remembered` are the indices of the states and memories of the birds, in order.
        """
        self._begun = begun
        self._configuration = configuration
        self._place = place
        self._birds = len(states)
        self._places = [*states, *remembered]

    def last_before(self, chunk: int, held: list[Message]) -> Found:
        """Find the last row in the first `chunk` chunks and the messages `held` after them.

        A row may begin in one chunk and end in a later one.
        """
        following: list[list[Message]] = []  # what may belong to a row of earlier chunks, reversed
        count = times = 0
        while True:
            count += len(held)
            times += self._times(held)
            begins = next((k for k, one in enumerate(held) if one.topic == self._places[0]), None)
            together = held
            if begins is not None or not chunk:
                together = [*held, *chain.from_iterable(reversed(following))]
                following.clear()
            end, states, memories = self._last_row(together)
            if states or not chunk:
                break
            following.append(held[:begins])
            chunk -= 1
            held = self._begun.messages(chunk)
        kept = together[:end]
        return Found(chunk, kept, count - end, times - self._times(kept), states, memories)

    def gap(self, last: Found, times: int) -> tuple[int, list[Message]] | None:
        """Find a missing row before `last`: return the number of the chunk and its beginning.

        Each row has one message on /clock, and the bag has `times` of them. If this number fits the
        last step, no row is missing, and the result is None.
        """
        every, clock = self._configuration.record_every, self._place[topics.CLOCK_TOPIC]
        times -= last.times_dropped
        if times == (messages.State.step_of(last.states[0]) // every + 1 if last.states else 0):
            return None
        step = 0
        for number in range(len(self._begun.chunks)):
            held = self._begun.messages(number)
            for at, (place, time, _) in enumerate(held):
                if place == clock:
                    if time != self._configuration.stamp(step):
                        return number, held[:at]
                    step += every
        return None

    def _times(self, held: Sequence[Message]) -> int:
        """Return the number of messages on /clock in `held`."""
        clock = self._place[topics.CLOCK_TOPIC]
        return sum(message.topic == clock for message in held)

    def _last_row(self, held: Sequence[Message]) -> tuple[int, list[bytes], list[bytes]]:
        """Return the end of the last whole row in `held`, its states and its memories.

        The end is after the grants and pushes that follow the row.
        """
        order = {place: k for k, place in enumerate(self._places)}
        between = {
            self._place.get(name) for name in (topics.GRANT_TOPIC, topics.PERTURBATION_TOPIC)
        }
        end, whole = 0, list[bytes]()
        row: list[bytes] = []
        step = -1
        for at, (place, _, data) in enumerate(held):
            k = order.get(place)
            if k is not None:
                said = (messages.State if k < self._birds else messages.Memory).step_of(data)
                if k == 0:
                    row, step = [], said
                if k == len(row) and said == step:
                    row.append(data)
                if len(row) == len(self._places):
                    end, whole, row = at + 1, row, []
            elif place in between and at == end:
                end = at + 1
        return end, whole[: self._birds], whole[self._birds :]
