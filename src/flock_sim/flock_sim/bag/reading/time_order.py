# SPDX-License-Identifier: Apache-2.0
"""The messages of a bag in the order of log time, whatever the order of its chunks and files."""

from bisect import bisect_left
from collections.abc import Callable, Iterable, Iterator, Mapping
from heapq import nlargest
from itertools import pairwise

from flock_sim.bag.reading.mcap_file import Part, Recorded

Place = tuple[int, int]
"""The number of a file and an offset in it: the order of a bag."""

Keyed = tuple[int, Place, int, Recorded]
"""A log time; then place and number in the part, which order messages with equal log times."""


def in_time_order(parts: Callable[[], Iterable[tuple[int, Part]]]) -> Iterator[Recorded]:
    """Yield the messages of `parts`, each given with the number of its file, by log time.

    Messages with equal times keep the order of the bag. Memory: the chunks that overlap in time,
    and some 200 bytes for each part if the parts are not in order.
    """
    starts = (part.start_time for _, part in parts())
    if all(one <= other for one, other in pairwise(starts)):
        ordered = parts()
    else:
        ordered = sorted(parts(), key=lambda part: part[1].start_time)
    waiting: list[Keyed] = []
    for number, part in ordered:
        due = bisect_left(waiting, part.start_time, key=lambda keyed: keyed[0])
        yield from (message for *_, message in waiting[:due])
        del waiting[:due]
        waiting += _keyed(number, part)
        waiting.sort()  # fast if they are already in order
    yield from (message for *_, message in waiting)


def latest(parts: Iterable[tuple[int, Part]], wanted: Mapping[str, int]) -> list[Recorded]:
    """Return the last messages of `parts` on each topic, by log time; `wanted` gives their number.

    Only the necessary parts are read.
    """
    found: dict[str, list[Keyed]] = {topic: [] for topic, many in wanted.items() if many > 0}
    for number, part in sorted(parts, key=lambda part: part[1].end_time, reverse=True):
        lacking = {
            topic
            for topic, keyed in found.items()
            if len(keyed) < wanted[topic] or keyed[-1][0] <= part.end_time
        }
        if not lacking:
            break
        if part.topics() and lacking.isdisjoint(part.topics()):
            continue
        for keyed in _keyed(number, part):
            topic = keyed[3][0]
            if topic in found:
                found[topic].append(keyed)
        found = {topic: nlargest(wanted[topic], keyed) for topic, keyed in found.items()}
    return [message for *_, message in sorted(keyed for kept in found.values() for keyed in kept)]


def _keyed(number: int, part: Part) -> Iterator[Keyed]:
    place = (number, part.offset)
    return ((each[1], place, index, each) for index, each in enumerate(part.read()))
