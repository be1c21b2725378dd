# SPDX-License-Identifier: Apache-2.0
"""Pairs the messages of two bags: states of the same bird at the same time."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Protocol

from flock_sim.bag.reading.reader import Recorded
from flock_sim.errors import FlockError
from flock_sim.messages.state_layout import same_head, step_of

MOST_WAITING = 64 * 2**20
"""Size of waiting messages above which topics are read one by one, in bytes."""


class States(Protocol):
    """A bag, of which only the messages are read: a `BagReader` or `VerifiedStates`."""

    @property
    def path(self) -> Path:
        """The path of the bag."""
        ...

    def messages(self, topics: list[str], /) -> Iterator[Recorded]:
        """Yield the messages (topic, log time, data) of `topics` in the order of the bag."""
        ...


Pair = tuple[str, bytes | None, bytes | None]

Ticks = tuple[Callable[[int], int], Callable[[int], int]]
"""For each bag: the time of a step, as a number that is equal for equal times in both bags."""


def by_step(step: int) -> int:
    """Return the time of a step if steps are equally long in both bags."""
    return step


class TooFarApartError(Exception):
    """The orders of messages in the bags differ so much that the queues would be too large."""


def pairs(
    first: States,
    second: States,
    topics: list[str],
    limit: int = MOST_WAITING,
    ticks: Ticks = (by_step, by_step),
) -> Iterator[Pair]:
    """Yield (topic, state in `first`, state in `second`), serialised; None for a missing state.

    States of a bird are a pair if `ticks` gives them the same time. Bags may interleave their
    topics in any way; the steps of one topic ascend. Memory is bounded: if more than `limit` bytes
    would wait, the rest is read topic by topic.

    Raises FlockError on a message that is no state.
    """
    given = dict.fromkeys(topics, 0)
    try:
        for pair in _Merge(first, second, topics, limit, ticks).pairs():
            given[pair[0]] += 1
            yield pair
    except TooFarApartError:
        for topic in topics:
            # The pairs of one topic have the same order in both passes.
            for number, pair in enumerate(_Merge(first, second, [topic], None, ticks).pairs()):
                if number >= given[topic]:
                    yield pair


class _Merge:
    """One pass over both bags. It reads the bag that is behind."""

    def __init__(
        self,
        first: States,
        second: States,
        topics: list[str],
        limit: int | None,
        ticks: Ticks,
    ) -> None:
        self._bags = (first, second)
        self._ticks = ticks
        self._sources = tuple(bag.messages(topics) for bag in self._bags)
        self._queues: dict[str, tuple[deque[bytes], deque[bytes]]] = {
            topic: (deque(), deque()) for topic in topics
        }
        self._limit = limit
        self._waiting = [0, 0]  # bytes in the queues of each bag
        self._ended = [False, False]

    def pairs(self) -> Iterator[Pair]:
        """Yield each pair as soon as it is known."""
        left, right = self._sources
        while not all(self._ended):
            if not any(self._waiting) and not any(self._ended):
                # Equal order, as two flights with one configuration have throughout.
                for one in left:
                    other = next(right, None)
                    if (
                        other is not None
                        and one[0] == other[0]
                        and (one[2] == other[2] or same_head(one[2], other[2]))
                    ):
                        yield one[0], one[2], other[2]
                        continue
                    yield from self._take(0, one)
                    yield from self._take(1, other)
                    break
                else:
                    yield from self._take(0, None)
                continue
            behind = int(self._waiting[1] < self._waiting[0])
            side = 1 - behind if self._ended[behind] else behind
            yield from self._take(side, next(self._sources[side], None))

    def _take(self, side: int, message: tuple[str, int, bytes] | None) -> Iterator[Pair]:
        """Take a message, or the end, of one bag. Yield the pairs that this completes."""
        if message is None:
            self._ended[side] = True
            for topic in self._queues:
                yield from self._settle(topic)
            return
        topic, _, data = message
        self._queues[topic][side].append(data)
        self._waiting[side] += len(data)
        yield from self._settle(topic)
        if self._limit is not None and sum(self._waiting) > self._limit:
            raise TooFarApartError

    def _settle(self, topic: str) -> Iterator[Pair]:
        left, right = self._queues[topic]
        while left or right:
            if left and right:
                ahead = self._time(0, topic, left[0]) - self._time(1, topic, right[0])
                yield topic, self._pop(0, left, ahead <= 0), self._pop(1, right, ahead >= 0)
            elif self._ended[1 if left else 0]:
                yield topic, self._pop(0, left, bool(left)), self._pop(1, right, bool(right))
            else:
                return

    def _pop(self, side: int, queue: deque[bytes], wanted: bool) -> bytes | None:
        if not wanted:
            return None
        data = queue.popleft()
        self._waiting[side] -= len(data)
        return data

    def _time(self, side: int, topic: str, data: bytes) -> int:
        try:
            return self._ticks[side](step_of(data))
        except ValueError as error:
            raise FlockError(
                f"{self._bags[side].path}: {topic}: {error}; take another copy of the bag"
            ) from error
