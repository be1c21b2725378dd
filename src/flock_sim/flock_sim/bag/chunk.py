# SPDX-License-Identifier: Apache-2.0
"""The layout of an MCAP chunk with its message indexes, packed by hand for speed."""

import struct
import zlib
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import chain

from mcap.opcode import Opcode
from zstandard import ZstdCompressor

# opcode, length of the rest, channel, sequence, log time (ns), publish time (ns); then the data.
MESSAGE = struct.Struct("<BQHIQQ")
MESSAGE_OPCODE = int(Opcode.MESSAGE)
MESSAGE_FIELDS = 22  # bytes of a message record between its length and its data

# opcode, length; start and end time (ns), uncompressed size, CRC, compression, compressed size.
_CHUNK = struct.Struct("<BQQQQII4sQ")
CHUNK_HEAD = _CHUNK.size  # bytes
_MESSAGE_INDEX = struct.Struct("<BQHI")
_CHUNK_INDEX = struct.Struct("<BQQQQQI")
_CHUNK_INDEX_END = struct.Struct("<QI4sQQ")
_FRAME = 9  # bytes of an opcode and a length
_ENTRY = 16  # bytes of a message's log time and offset in a message index


Entries = Iterable[tuple[int, list[int]]]
"""For each channel, [log time, offset in body, log time, offset in body, ...] of its messages."""


@dataclass(frozen=True)
class ChunkSummary:
    """The entry of a chunk in the summary of a file."""

    index: bytes  # its ChunkIndex record
    start_time: int  # ns, of its earliest message
    end_time: int  # ns, of its latest message
    counts: tuple[tuple[int, int], ...]  # (channel, messages)


@dataclass(frozen=True)
class SealedChunk:
    """A finished chunk."""

    record: bytes  # the chunk and the message indexes that follow it
    summary: ChunkSummary


def seal(
    body: bytes | bytearray, entries: Entries, offset: int, compressor: ZstdCompressor
) -> SealedChunk:
    """Compress and index `body`, not empty, for a chunk that will begin at byte `offset`.

    `body` is a sequence of message records, `entries` has their offsets.
    """
    packed = compressor.compress(body)
    head = chunk_head(body, entries, len(packed))
    indexes = message_indexes(entries)
    return SealedChunk(head + packed + indexes, summarise(head, indexes, offset))


def chunk_head(body: bytes | bytearray, entries: Entries, packed_size: int) -> bytes:
    """Make the part of a chunk's record before the compressed body of `packed_size` bytes."""
    channels = [flat for _, flat in entries if flat]
    return _CHUNK.pack(
        Opcode.CHUNK,
        _CHUNK.size - _FRAME + packed_size,
        min(min(flat[::2]) for flat in channels),
        max(max(flat[::2]) for flat in channels),
        len(body),
        zlib.crc32(body),
        4,
        b"zstd",
        packed_size,
    )


def message_indexes(entries: Entries) -> bytes:
    """Make the message indexes that follow a chunk: one for each channel with messages."""
    parts: list[bytes] = []
    for channel, flat in entries:
        if flat:
            size = 8 * len(flat)
            parts.append(_MESSAGE_INDEX.pack(Opcode.MESSAGE_INDEX, 6 + size, channel, size))
            parts.append(struct.pack(f"<{len(flat)}Q", *flat))
    return b"".join(parts)


def summarise(head: bytes, indexes: bytes, offset: int) -> ChunkSummary:
    """Summarise the chunk at byte `offset` from its first bytes and its message indexes.

    Raises ValueError if these do not fit together.
    """
    try:
        _, length, start, end, size, _, _, _, packed_size = _CHUNK.unpack_from(head)
        chunk_length = _FRAME + length
        at = 0
        places: list[tuple[int, int]] = []
        counts: list[tuple[int, int]] = []
        while at < len(indexes):
            opcode, length, channel, entries_size = _MESSAGE_INDEX.unpack_from(indexes, at)
            if opcode != Opcode.MESSAGE_INDEX or length != 6 + entries_size:
                raise ValueError("a message index does not parse")
            places.append((channel, offset + chunk_length + at))
            counts.append((channel, entries_size // _ENTRY))
            at += _FRAME + length
    except struct.error as error:
        raise ValueError(f"a chunk or its message index is cut short: {error}") from error
    index = b"".join(
        (
            _CHUNK_INDEX.pack(
                Opcode.CHUNK_INDEX,
                _CHUNK_INDEX.size - _FRAME + 10 * len(places) + _CHUNK_INDEX_END.size,
                start,
                end,
                offset,
                chunk_length,
                10 * len(places),
            ),
            struct.pack("<" + "HQ" * len(places), *chain.from_iterable(places)),
            _CHUNK_INDEX_END.pack(len(indexes), 4, b"zstd", packed_size, size),
        )
    )
    return ChunkSummary(index, start, end, tuple(counts))
