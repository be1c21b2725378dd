# SPDX-License-Identifier: Apache-2.0
"""The messages of a bag in the order of log time, whatever the order of its chunks and files."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from heapq import heappop, heappush, heappushpop
from itertools import pairwise

from flock_sim.bag import limits
from flock_sim.bag.reading.mcap_file import Part, Recorded

Place = tuple[int, int]
"""The number of a file and an offset in it: the order of a bag."""

Keyed = tuple[int, Place, int, Recorded]
"""A log time; then place and number in the part, which order messages with equal log times."""


def in_time_order(parts: Callable[[], Iterable[tuple[int, Part]]]) -> Iterator[Recorded]:
    """Yield the messages of `parts`, each given with the number of its file, by log time.

    Messages with equal times keep the order of the bag. Memory: the chunks that overlap in time,
    and some 200 bytes for each part if the parts are not in order. Raises LimitError if that is
    more than OVERLAP.
    """
    starts = (part.start_time for _, part in parts())
    if all(one <= other for one, other in pairwise(starts)):
        ordered = parts()
    else:
        ordered = sorted(parts(), key=lambda part: part[1].start_time)
    waiting: list[Keyed] = []  # a heap
    kept = KeptSize()
    for number, part in ordered:
        while waiting and waiting[0][0] < part.start_time:
            *_, message = heappop(waiting)
            kept.remove(message)
            yield message
        alone = not waiting
        for keyed in _keyed(number, part):
            kept.add(keyed[3])
            if alone:
                waiting.append(keyed)
            else:
                heappush(waiting, keyed)
        if alone:
            waiting.sort()  # a heap, too; fast if they are already in order
    while waiting:
        yield heappop(waiting)[3]


def latest(parts: Iterable[tuple[int, Part]], wanted: Mapping[str, int]) -> list[Recorded]:
    """Return the last messages of `parts` on each topic, by log time; `wanted` gives their number.

    Only the necessary parts are read. Raises LimitError if the messages are larger than OVERLAP.
    """
    found: dict[str, list[Keyed]] = {topic: [] for topic, many in wanted.items() if many > 0}
    lacking = set(found)
    kept = KeptSize()
    for number, part in sorted(parts, key=lambda part: part[1].end_time, reverse=True):
        # Parts end earlier and earlier, so a topic that lacks nothing once lacks nothing later.
        of_part = part.topics() & lacking if part.topics() else set(lacking)
        complete = {
            topic
            for topic in of_part
            if len(found[topic]) == wanted[topic] and found[topic][0][0] > part.end_time
        }
        lacking -= complete
        if not lacking:
            break
        if of_part <= complete:
            continue
        for keyed in _keyed(number, part):
            message = keyed[3]
            heap = found.get(message[0])
            if heap is None:
                continue
            kept.add(message)
            if len(heap) < wanted[message[0]]:
                heappush(heap, keyed)
            else:
                kept.remove(heappushpop(heap, keyed)[3])
    return [message for *_, message in sorted(keyed for heap in found.values() for keyed in heap)]


class KeptSize:
    """The size of the messages that are kept."""

    def __init__(self) -> None:
        self._size = 0

    def add(self, message: Recorded) -> None:
        """Count a message; raises LimitError if they are too large."""
        self._size += len(message[2]) + limits.MESSAGE_COST
        if self._size > limits.OVERLAP:
            limits.check(self._size, limits.OVERLAP, "bytes of messages that overlap in time")

    def remove(self, message: Recorded) -> None:
        """Do not count a message any longer."""
        self._size -= len(message[2]) + limits.MESSAGE_COST


def _keyed(number: int, part: Part) -> Iterator[Keyed]:
    place = (number, part.offset)
    return ((each[1], place, index, each) for index, each in enumerate(part.read()))
