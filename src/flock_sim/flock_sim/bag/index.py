# SPDX-License-Identifier: Apache-2.0
"""The contents of an MCAP file, from its summary or by a pass over its records."""

import os
import struct
import zlib
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import pairwise

from mcap.opcode import Opcode
from mcap.records import Channel, Footer, Metadata, MetadataIndex, Schema, Statistics

from flock_sim.bag import limits
from flock_sim.bag.file_sections import MAGIC
from flock_sim.bag.records import (
    CHUNK_TIMES,
    FRAME,
    MESSAGE_HEAD,
    ChunkPlace,
    DamagedError,
    parse,
    read_chunk,
    read_content,
    read_frame,
    records_in,
)
from flock_sim.bag.salvage import goes_on

_DEFINING = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.METADATA)
_FOOTER_SIZE = FRAME.size + 20  # bytes
_END_SIZE = _FOOTER_SIZE + len(MAGIC)
_CHUNK_INDEX = struct.Struct("<QQQQI")
"""The beginning of the index of a chunk: start and end time in ns, offset and length in bytes, and
the size in bytes of the map that follows, from channels to the offsets of their message indexes."""
_CHANNEL_OFFSET = struct.Struct("<HQ")
_NUMBER_SIZE = 2  # bytes of the number of a schema or channel, at the beginning of its record
CRC_SIZE = 4
"""Size of a CRC in the footer and in the record that ends the data, in bytes."""


@dataclass
class Contents:
    """The inventory of one MCAP file.

    `loose`: the file has messages outside of chunks, which only a pass over the records finds.
    `whole`: end of the last whole record of the data, in bytes. `missing`: None for a complete
    file, or some words on what is missing.
    """

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    chunks: list[ChunkPlace] = field(default_factory=list)
    counts: dict[int, int] | None = None  # messages by channel, where there is a summary
    first_time: int | None = None  # ns, the earliest log time; None without messages
    last_time: int | None = None  # ns, the latest log time; None without messages
    loose: bool = False
    whole: int = 0
    missing: str | None = None
    defined: dict[tuple[int, bytes], bytes] = field(default_factory=dict)  # by opcode and number
    definitions: int = 0  # records, without equal copies
    definitions_size: int = 0  # bytes

    def define(self, opcode: int, content: bytes) -> None:
        """Add a schema, channel or metadata record, and ignore others.

        Raises DamagedError, and LimitError if there are too many.
        """
        if opcode not in _DEFINING or self._is_copy(opcode, content):
            return
        self.definitions += 1
        self.definitions_size += len(content)
        limits.check(self.definitions, limits.MOST_DEFINITIONS, "definitions")
        limits.check(
            self.definitions_size,
            limits.DEFINITIONS_SIZE,
            "bytes of schemas, channels and metadata",
        )
        if opcode == Opcode.SCHEMA:
            schema: Schema = parse(Schema.read, content)
            self.schemas[schema.id] = schema
        elif opcode == Opcode.CHANNEL:
            channel: Channel = parse(Channel.read, content)
            self.channels[channel.id] = channel
        elif opcode == Opcode.METADATA:
            record: Metadata = parse(Metadata.read, content)
            self.metadata[record.name] = record.metadata

    def _is_copy(self, opcode: int, content: bytes) -> bool:
        """Whether a schema or channel is the one that has its number already; keep it if not."""
        if opcode == Opcode.METADATA:
            return False
        key = opcode, content[:_NUMBER_SIZE]
        copy = self.defined.get(key) == content
        self.defined[key] = content
        return copy

    def read_definition(self, fd: int, opcode: int, offset: int, length: int) -> None:
        """Read and add the definition at `offset`; raises DamagedError and LimitError."""
        if offset + FRAME.size + length <= os.fstat(fd).st_size:
            limits.check(length, limits.LARGEST_DEFINITION, "bytes in one definition")
        self.define(opcode, read_content(fd, offset, length))

    def add_chunk(self, place: ChunkPlace) -> None:
        """Add a chunk; raises LimitError if there are too many."""
        self.chunks.append(place)
        limits.check(len(self.chunks), limits.MOST_CHUNKS, "chunks")

    def meet(self, time: int) -> None:
        """Extend the range of log times to `time`, in ns."""
        self.first_time = time if self.first_time is None else min(self.first_time, time)
        self.last_time = time if self.last_time is None else max(self.last_time, time)


def has_end(fd: int) -> bool:
    """Tell whether the file ends with a footer and the magic, as a complete file does."""
    size = os.fstat(fd).st_size
    end = os.pread(fd, _END_SIZE, max(0, size - _END_SIZE))
    return end[:1] == bytes([Opcode.FOOTER]) and end.endswith(MAGIC)


def summarised(fd: int) -> Contents | None:
    """Read the summary of a file that has its end; None if the summary is absent or incomplete.

    Raises DamagedError if the summary is damaged.
    """
    end = os.fstat(fd).st_size - _END_SIZE
    footer: Footer = parse(Footer.read, read_content(fd, end, _FOOTER_SIZE - FRAME.size))
    if footer.summary_start == 0:
        return None
    if footer.summary_start > end:
        raise DamagedError("it begins after its end")
    size = end - footer.summary_start
    if size > limits.LARGEST_SUMMARY:
        raise DamagedError(f"it has {limits.beyond(size, limits.LARGEST_SUMMARY, 'bytes')}")
    summary = os.pread(fd, size, footer.summary_start)
    # The CRC covers the summary and the footer up to the CRC itself, its last field.
    signed = os.pread(fd, _FOOTER_SIZE - CRC_SIZE, end)
    if footer.summary_crc and zlib.crc32(signed, zlib.crc32(summary)) != footer.summary_crc:
        raise DamagedError("its CRC does not match")

    contents = Contents(whole=footer.summary_start)
    statistics: Statistics | None = None
    metadata_count = 0  # several records may have one name
    sets = _ChannelSets()
    for opcode, content in records_in(summary):
        contents.define(opcode, content)
        if opcode == Opcode.STATISTICS:
            statistics = parse(Statistics.read, content)
        elif opcode == Opcode.CHUNK_INDEX:
            contents.add_chunk(_indexed_chunk(content, sets))
        elif opcode == Opcode.METADATA_INDEX:
            index: MetadataIndex = parse(MetadataIndex.read, content)
            frame = read_frame(fd, index.offset)
            if frame is None or frame[0] != Opcode.METADATA:
                raise DamagedError(f"there is no metadata at byte {index.offset}")
            contents.read_definition(fd, frame[0], index.offset, frame[1])
            metadata_count += 1

    if (
        statistics is None
        or statistics.channel_count != len(contents.channels)
        or statistics.chunk_count != len(contents.chunks)
        or statistics.metadata_count != metadata_count
    ):
        return None
    contents.chunks.sort()  # by offset: the order of the file
    for place, following in pairwise(contents.chunks):
        if place.offset + place.length > following.offset:
            raise DamagedError(f"its chunk at byte {following.offset} begins within another one")
    contents.counts = statistics.channel_message_counts
    contents.loose = statistics.message_count > 0 and not contents.chunks
    if statistics.message_count:
        contents.meet(statistics.message_start_time)
        contents.meet(statistics.message_end_time)
    return contents


class _ChannelSets:
    """The sets of channels of chunks; most chunks have the same ones."""

    def __init__(self) -> None:
        # By the low and high bytes of the channels, which is faster than to unpack them.
        self._sets: dict[tuple[bytes, bytes], frozenset[int]] = {}
        self._room = limits.MOST_INDEXED

    def of(self, offsets: bytes) -> frozenset[int]:
        """Return the channels in the index of a chunk; empty, as if unknown, without room."""
        key = offsets[:: _CHANNEL_OFFSET.size], offsets[1 :: _CHANNEL_OFFSET.size]
        channels = self._sets.get(key)
        if channels is None:
            self._room -= len(key[0])
            if self._room < 0:
                return frozenset()
            channels = frozenset(channel for channel, _ in _CHANNEL_OFFSET.iter_unpack(offsets))
            self._sets[key] = channels
        return channels


def _indexed_chunk(content: bytes, sets: _ChannelSets) -> ChunkPlace:
    """Return the place of a chunk from its index, faster than `parse`; raises DamagedError."""
    if len(content) < _CHUNK_INDEX.size:
        raise DamagedError("the index of a chunk is cut short")
    start, end, offset, length, size = _CHUNK_INDEX.unpack_from(content)
    offsets = content[_CHUNK_INDEX.size : _CHUNK_INDEX.size + size]
    if len(offsets) < size or size % _CHANNEL_OFFSET.size:
        raise DamagedError("the channels in the index of a chunk are cut short")
    return ChunkPlace(offset, length, start, end, sets.of(offsets))


def scanned(fd: int) -> Contents:
    """Read the contents up to the last whole record.

    Damaged chunks at the end are left out. `missing` tells how many bytes of data are not used, or
    is None. Only the last chunk is read, unless chunks contain their own definitions.
    """
    size = os.fstat(fd).st_size
    contents = Contents(whole=len(MAGIC))
    data_end = _walk(fd, size, contents)
    _drop_damaged_tail(fd, contents)
    _learn_from_chunks(fd, contents)
    for place in contents.chunks:
        if place.end_time or place.channels:  # a chunk without messages has no times
            contents.meet(place.start_time)
            contents.meet(place.end_time)
    lost = data_end - contents.whole
    if lost and goes_on(fd, contents.whole):
        contents.missing = (
            f"byte {contents.whole} is damaged, and only ./flock repair reads the {lost} bytes of"
            " data that follow"
        )
    elif lost:
        contents.missing = f"the last {lost} bytes of data are incomplete and are left out"
    return contents


def _walk(fd: int, size: int, contents: Contents) -> int:
    """Add the records up to the first that is not whole; return where the data should end."""
    indexed: set[int] = set()  # channels of the chunk before
    with suppress(DamagedError):
        while frame := read_frame(fd, contents.whole):
            opcode, length = frame
            offset = contents.whole
            after = offset + FRAME.size + length
            if after > size:
                return size
            if opcode != Opcode.MESSAGE_INDEX and indexed:
                contents.chunks[-1] = contents.chunks[-1]._replace(channels=frozenset(indexed))
                indexed.clear()
            if opcode == Opcode.DATA_END:
                return offset
            if opcode in _DEFINING:
                contents.read_definition(fd, opcode, offset, length)
            elif opcode == Opcode.CHUNK and length >= CHUNK_TIMES.size:
                start, end = CHUNK_TIMES.unpack(read_content(fd, offset, CHUNK_TIMES.size))
                place = ChunkPlace(offset, FRAME.size + length, start, end, frozenset())
                contents.add_chunk(place)
            elif opcode == Opcode.MESSAGE_INDEX and contents.chunks:
                channel = read_content(fd, offset, min(length, 2))
                indexed.add(int.from_bytes(channel, "little"))
            elif opcode == Opcode.MESSAGE and length >= MESSAGE_HEAD.size:
                _, _, time, _ = MESSAGE_HEAD.unpack(read_content(fd, offset, MESSAGE_HEAD.size))
                contents.meet(time)
                contents.loose = True
            contents.whole = after
    return size


def _drop_damaged_tail(fd: int, contents: Contents) -> None:
    """Leave out chunks at the end that were not completely written because of a power cut."""
    unpacked = limits.Unpacked(fd)
    while contents.chunks:
        try:
            read_chunk(fd, contents.chunks[-1], unpacked)
            return
        except DamagedError:
            contents.whole = contents.chunks.pop().offset


def _learn_from_chunks(fd: int, contents: Contents) -> None:
    """Find definitions that are only in chunks, where most other writers place them."""
    unpacked = limits.Unpacked(fd)
    for place in contents.chunks:
        if not place.channels or not place.channels <= contents.channels.keys():
            with suppress(DamagedError):  # reported when its messages are read
                for opcode, content in records_in(read_chunk(fd, place, unpacked)):
                    contents.define(opcode, content)
