# SPDX-License-Identifier: Apache-2.0
"""One MCAP file, opened for reading."""

import os
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path

from mcap.opcode import Opcode

from flock_sim.bag.contents import Contents, has_end, summarised
from flock_sim.bag.frames import (
    FRAME,
    ChunkPlace,
    DamagedError,
    messages_in,
    read_chunk,
    read_content,
    read_frame,
)
from flock_sim.bag.layout import MAGIC
from flock_sim.bag.scan import scanned
from flock_sim.errors import FlockError

_FOREVER = 1 << 64  # ns, above every log time


class McapFile:
    """The attributes and methods of `BagReader`, for one of its files."""

    def __init__(self, path: Path) -> None:
        """Open the file and find what is in it; raises FlockError where it is not MCAP."""
        self.path = path
        try:
            # A Python file only so that it closes with its last user; read by os.pread.
            self._file = path.open("rb", buffering=0)
            magic = os.pread(self._file.fileno(), len(MAGIC), 0)
        except FileNotFoundError as error:
            raise FlockError(f"there is no bag {path}: name a bag directory") from error
        except OSError as error:
            raise FlockError(f"{path} can't be read: {error.strerror}") from error
        if magic != MAGIC:
            self.close()
            what = "is not an MCAP file" if magic else "is an empty file"
            raise FlockError(f"{path} {what}: name a bag that was recorded by fly or reference")
        try:
            contents = _take_stock(self._file.fileno())
        except OSError as error:
            self.close()
            raise FlockError(f"{path} can't be read: {error.strerror}") from error
        self._chunks = contents.chunks
        self._loose = contents.loose
        self._end = contents.whole
        self._topic_of = {number: channel.topic for number, channel in contents.channels.items()}
        self.topics = {
            channel.topic: contents.schemas[channel.schema_id].name
            if channel.schema_id in contents.schemas
            else ""
            for channel in contents.channels.values()
        }
        self.channels = {channel.topic: channel for channel in contents.channels.values()}
        self.metadata: Mapping[str, dict[str, str]] = contents.metadata
        self.message_counts = self._count(contents.counts)
        self.last_time = contents.last_time
        self.missing = contents.missing

    def messages(
        self, topics: Collection[str] | None, start: int | None, end: int | None
    ) -> Iterator[tuple[str, int, bytes]]:
        """Yield messages as `BagReader.messages` does."""
        since = 0 if start is None else start
        until = _FOREVER if end is None else end
        wanted = {
            number: topic
            for number, topic in self._topic_of.items()
            if topics is None or topic in topics
        }
        for opcode, place in self._places():
            if place.end_time < since or place.start_time >= until:
                continue
            if place.channels and place.channels.isdisjoint(wanted):
                continue
            try:
                yield from messages_in(self._body(opcode, place), wanted, since, until)
            except DamagedError as error:
                raise FlockError(
                    f"{self.path} is damaged at byte {place.offset} ({error}):"
                    " take another copy of the bag"
                ) from error
            except OSError as error:
                raise FlockError(f"{self.path} can't be read: {error.strerror}") from error

    def close(self) -> None:
        """Close the file; a second call does nothing."""
        self._file.close()

    def _count(self, counts: Mapping[int, int] | None) -> dict[str, int] | None:
        if counts is None:
            return None
        by_topic = dict.fromkeys(self.topics, 0)
        for number, topic in self._topic_of.items():
            by_topic[topic] += counts.get(number, 0)
        return by_topic

    def _places(self) -> Iterator[tuple[int, ChunkPlace]]:
        """Yield the chunks in order, and between them the messages outside of chunks, if any."""
        if not self._loose:
            yield from ((Opcode.CHUNK, place) for place in self._chunks)
            return
        chunks = {place.offset: place for place in self._chunks}
        offset = len(MAGIC)
        while offset < self._end and (frame := read_frame(self._file.fileno(), offset)):
            opcode, length = frame
            if opcode == Opcode.CHUNK and offset in chunks:
                yield opcode, chunks[offset]
            elif opcode == Opcode.MESSAGE:
                yield opcode, ChunkPlace(offset, FRAME.size + length, 0, _FOREVER, frozenset())
            offset += FRAME.size + length

    def _body(self, opcode: int, place: ChunkPlace) -> bytes:
        fd = self._file.fileno()
        if opcode == Opcode.CHUNK:
            return read_chunk(fd, place)
        length = place.length - FRAME.size
        return FRAME.pack(opcode, length) + read_content(fd, place.offset, length)


def _take_stock(fd: int) -> Contents:
    """Take the contents from the summary where there is a sound one."""
    ended = has_end(fd)
    damage = "" if ended else "there is no summary"
    if ended:
        try:
            contents = summarised(fd)
            if contents is not None:
                return contents
        except DamagedError as error:
            damage = f"the summary is damaged ({error})"
    contents = scanned(fd)
    contents.missing = "; ".join(filter(None, (damage, contents.missing))) or None
    return contents
