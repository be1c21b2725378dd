# SPDX-License-Identifier: Apache-2.0
"""One MCAP file, opened for reading."""

import os
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import IO, NamedTuple

from mcap.opcode import Opcode
from mcap.records import Channel

from flock_sim.bag import limits
from flock_sim.bag.file_sections import MAGIC
from flock_sim.bag.index import CRC_SIZE, Contents, has_end, scanned, summarised
from flock_sim.bag.reading.compression import ZSTD_MAGIC, unpacked_file
from flock_sim.bag.reading.other_formats import conversion, format_of_content
from flock_sim.bag.records import (
    FRAME,
    MESSAGE_HEAD,
    ChunkPlace,
    DamagedError,
    crc_of,
    messages_in,
    read_chunk,
    read_content,
    read_cut_chunk,
    read_frame,
)
from flock_sim.bag.salvage import sound_chunks
from flock_sim.errors import FlockError
from flock_sim.outside.regular_file import open_file

_FOREVER = 1 << 64  # ns, above every log time

Recorded = tuple[str, int, bytes]
"""Topic, log time in ns, serialised data."""


class Stream(NamedTuple):
    """Channels with equal topic, type and encoding. A topic may have several types or encodings."""

    topic: str
    type: str  # empty where the channel has no schema
    encoding: str


class Part(NamedTuple):
    """Messages that are read at once: those of a chunk, or one outside of chunks."""

    start_time: int  # ns, of its earliest message
    end_time: int  # ns, of its latest message
    offset: int  # bytes: parts of a file are in this order
    topics: Callable[[], set[str]]  # of its messages; empty if the file does not have them
    read: Callable[[], Iterator[Recorded]]


@contextmanager
def _readable(path: Path) -> Iterator[None]:
    """Raise FlockError, which names the file, for an OSError in the block."""
    try:
        yield
    except OSError as error:
        raise FlockError(f"{path} can't be read: {error.strerror}") from error


class McapFile:
    """The attributes and methods of `BagReader`, for one of its files."""

    def __init__(self, path: Path) -> None:
        """Open the file and find its contents; raises FlockError if it is not MCAP."""
        self.path = path
        packed = None
        with _readable(path):
            try:
                # It is read by os.pread. A Python file object closes it after its last use.
                self._file: IO[bytes] = open_file(path)
            except FileNotFoundError as error:
                raise FlockError(f"there is no bag {path}: name a bag directory") from error
            magic = os.pread(self._file.fileno(), len(MAGIC), 0)
            if magic.startswith(ZSTD_MAGIC):
                with self._file as file:
                    self._file, packed = unpacked_file(file, path)
                magic = os.pread(self._file.fileno(), len(MAGIC), 0)
        if magic != MAGIC:
            self.close()
            if other := format_of_content(magic):
                raise FlockError(f"{path} is {other}, not MCAP: {conversion(other, path)}")
            what = "is not an MCAP file" if magic else "is an empty file"
            raise FlockError(f"{path} {what}: name a bag that was recorded by fly or reference")
        try:
            with _readable(path):
                contents = _take_stock(self._file.fileno())
        except limits.LimitError as error:
            self.close()
            raise FlockError(f"{path} {error}: take another copy of the bag") from error
        except FlockError:
            self.close()
            raise
        self._chunks = contents.chunks
        self._loose = contents.loose
        self._end = contents.whole
        self._topic_of = {number: channel.topic for number, channel in contents.channels.items()}
        self.types = {schema.name for schema in contents.schemas.values()}
        self._stream_of: dict[int, Stream] = {}
        self.streams: dict[Stream, list[Channel]] = {}
        for number, channel in contents.channels.items():
            # An id of 0 means that there is no schema.
            schema = contents.schemas.get(channel.schema_id) if channel.schema_id else None
            kind = schema.name if schema else ""
            stream = Stream(channel.topic, kind, channel.message_encoding)
            self._stream_of[number] = stream
            self.streams.setdefault(stream, []).append(channel)
        self.topics = {stream.topic: stream.type for stream in self._stream_of.values()}
        self.metadata: Mapping[str, dict[str, str]] = contents.metadata
        self.message_counts = self._count(contents.counts)
        self.first_time = contents.first_time
        self.last_time = contents.last_time
        self.missing = "; ".join(filter(None, (packed, contents.missing))) or None

    def messages(
        self, topics: Collection[str] | None, start: int | None, end: int | None
    ) -> Iterator[tuple[str, int, bytes]]:
        """Yield messages as `BagReader.messages` does."""
        wanted = {
            number: topic
            for number, topic in self._topic_of.items()
            if topics is None or topic in topics
        }
        for part in self._parts(wanted, start, end):
            yield from part.read()

    def parts(
        self, streams: Collection[Stream], start: int | None, end: int | None
    ) -> Iterator[Part]:
        """Yield, in file order, the parts that may have messages of `streams` in [start, end)."""
        chosen = frozenset(streams)
        wanted = {
            number: stream.topic for number, stream in self._stream_of.items() if stream in chosen
        }
        return self._parts(wanted, start, end)

    def _parts(
        self, wanted: Mapping[int, str], start: int | None, end: int | None
    ) -> Iterator[Part]:
        since = 0 if start is None else start
        until = _FOREVER if end is None else end
        with _readable(self.path):
            unpacked = limits.Unpacked(self._file.fileno())
        for opcode, place in self._places():
            if place.end_time < since or place.start_time >= until:
                continue
            if place.channels and place.channels.isdisjoint(wanted):
                continue
            topics = partial(_topics, wanted, place.channels)
            read = partial(self._read, opcode, place, wanted, since, until, unpacked)
            yield Part(place.start_time, place.end_time, place.offset, topics, read)

    def _read(
        self,
        opcode: int,
        place: ChunkPlace,
        wanted: Mapping[int, str],
        since: int,
        until: int,
        unpacked: limits.Unpacked,
    ) -> Iterator[Recorded]:
        try:
            with _readable(self.path):
                body = self._body(opcode, place, unpacked)
            yield from messages_in(body, wanted, since, until)
        except limits.LimitError as error:
            raise FlockError(
                f"{self.path} {error}: take another copy of the bag, or write it without"
                " compression with ros2 bag convert"
            ) from error
        except DamagedError as error:
            raise FlockError(
                f"{self.path} is damaged at byte {place.offset} ({error}):"
                " take another copy of the bag, or recover the undamaged part of a flight with"
                " ./flock repair"
            ) from error

    def salvage(self, broken: list[str], cut: list[str] | None = None) -> Iterator[Recorded]:
        """Yield the messages of all sound chunks; add a line to `broken` for each damaged place.

        With `cut`, also yield the messages before the cut in a chunk that the end of the file cuts,
        and add a line on it to `cut`.
        """
        try:
            with _readable(self.path):
                yield from (
                    self._salvaged_loose(broken) if self._loose else self._salvaged(broken, cut)
                )
        except limits.LimitError as error:
            raise FlockError(f"{self.path} {error}: take another copy of the bag") from error

    def _salvaged(self, broken: list[str], cut: list[str] | None) -> Iterator[Recorded]:
        fd = self._file.fileno()
        unpacked = limits.Unpacked(fd)
        for chunk in sound_chunks(fd, len(MAGIC)):
            unpacked.add(len(chunk.body))
            # `missing` reports a torn end.
            torn = chunk.damage is not None and not (chunk.body or has_end(fd))
            if chunk.damage is not None and not torn:
                broken.append(f"{self.path} is damaged at byte {chunk.damage}")
            try:
                yield from messages_in(chunk.body, self._topic_of, 0, _FOREVER)
            except DamagedError:  # its CRC, if any, is that of damaged records
                broken.append(f"{self.path} is damaged at byte {chunk.offset}")
            if torn and chunk.damage is not None and cut is not None:
                yield from self._salvaged_cut(chunk.damage, cut)

    def _salvaged_cut(self, offset: int, cut: list[str]) -> Iterator[Recorded]:
        """Salvage the chunk at byte `offset`, which the end of the file cuts."""
        body = read_cut_chunk(self._file.fileno(), offset)
        found: list[Recorded] = []
        with suppress(DamagedError):
            found.extend(messages_in(body, self._topic_of, 0, _FOREVER))
        if found:
            cut.append(
                f"among them are the {len(found)} whole messages at the beginning of the chunk at"
                f" byte {offset} of {self.path.name}, which is cut"
            )
        yield from found

    def _salvaged_loose(self, broken: list[str]) -> Iterator[Recorded]:
        """Salvage a file with messages outside of chunks, which look the same as damage."""
        unpacked = limits.Unpacked(self._file.fileno())
        for opcode, place in self._places():
            try:
                body = self._body(opcode, place, unpacked)
                yield from messages_in(body, self._topic_of, 0, _FOREVER)
            except DamagedError:
                broken.append(f"{self.path} is damaged at byte {place.offset}")

    def crc_fits(self) -> bool:
        """Read the whole file, and tell whether the CRC at the end of its data, if any, fits."""
        fd = self._file.fileno()
        end = self._end - FRAME.size - CRC_SIZE
        with _readable(self.path):
            if self.missing or read_frame(fd, end) != (Opcode.DATA_END, CRC_SIZE):
                return True
            crc = int.from_bytes(read_content(fd, end, CRC_SIZE), "little")
            return crc in (0, crc_of(fd, end))

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
        with _readable(self.path):
            while offset < self._end and (frame := read_frame(self._file.fileno(), offset)):
                opcode, length = frame
                if opcode == Opcode.CHUNK and offset in chunks:
                    yield opcode, chunks[offset]
                elif opcode == Opcode.MESSAGE:
                    yield opcode, self._message_place(offset, length)
                offset += FRAME.size + length

    def _message_place(self, offset: int, length: int) -> ChunkPlace:
        start, end, channels = 0, _FOREVER, frozenset[int]()
        if length >= MESSAGE_HEAD.size:
            head = os.pread(self._file.fileno(), MESSAGE_HEAD.size, offset + FRAME.size)
            channel, _, start, _ = MESSAGE_HEAD.unpack(head)
            end, channels = start, frozenset([channel])
        return ChunkPlace(offset, FRAME.size + length, start, end, channels)

    def _body(self, opcode: int, place: ChunkPlace, unpacked: limits.Unpacked) -> bytes:
        fd = self._file.fileno()
        if opcode == Opcode.CHUNK:
            return read_chunk(fd, place, unpacked)
        length = place.length - FRAME.size
        return FRAME.pack(opcode, length) + read_content(fd, place.offset, length)


def _topics(names: Mapping[int, str], channels: frozenset[int]) -> set[str]:
    return {names[channel] for channel in channels if channel in names}


def _take_stock(fd: int) -> Contents:
    """Read the contents from the summary, or by a scan if there is no sound summary."""
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
