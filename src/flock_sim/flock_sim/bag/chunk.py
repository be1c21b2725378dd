# SPDX-License-Identifier: Apache-2.0
"""An MCAP chunk with its message indexes, packed by hand for speed."""

import struct
import zlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import chain

from mcap.opcode import Opcode
from zstandard import ZstdCompressor

from flock_sim.bag.records import FRAME, MESSAGE, MESSAGE_HEAD, MESSAGE_OPCODE

# opcode, length; start and end time (ns), uncompressed size, CRC, compression, compressed size.
_CHUNK = struct.Struct("<BQQQQII4sQ")
CHUNK_HEAD = _CHUNK.size  # bytes
MESSAGE_INDEX = struct.Struct("<BQHI")  # opcode, length of the rest, channel, bytes of entries
_CHUNK_INDEX = struct.Struct("<BQQQQQI")
_CHUNK_INDEX_END = struct.Struct("<QI4sQQ")
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


class OpenChunk:
    """Messages by channel. Added messages count from `take` on, so that a group counts as a whole.

    `size` is the uncompressed size of the taken messages, in bytes.
    """

    def __init__(self, topics: Sequence[str]) -> None:
        """Accept messages of `topics`, channels 1, 2, ..."""
        # For each channel, [log time, offset in body, log time, offset in body, ...].
        self._entries: list[tuple[int, list[int]]] = [
            (channel, []) for channel in range(1, len(topics) + 1)
        ]
        self._slots: dict[int | str, tuple[int, list[int]]] = dict(enumerate(self._entries))
        self._slots.update(zip(topics, self._entries, strict=True))
        self._body = bytearray()
        self.size = 0

    def add(
        self, topic: int | str, log_time: int, data: bytes, publish_time: int, sequence: int
    ) -> None:
        """Append a message; `topic` is its name or its index, from 0.

        Raises KeyError for an unknown topic, struct.error for values that a message can't hold.
        """
        channel, entries = self._slots[topic]
        body = self._body
        at = len(body)
        body += MESSAGE.pack(
            MESSAGE_OPCODE, MESSAGE_HEAD.size + len(data), channel, sequence, log_time, publish_time
        )
        body += data
        entries += (log_time, at)

    def take(self) -> None:
        """Make all added messages count."""
        self.size = len(self._body)

    def drop_incomplete(self) -> None:
        """Drop messages that were added but, because of an exception such as Ctrl-C, not taken."""
        if len(self._body) == self.size:
            return
        for _, entries in self._entries:
            while entries and entries[-1] >= self.size:
                del entries[-2:]
        del self._body[self.size :]

    def clear(self) -> None:
        """Drop everything."""
        self.size = 0
        for _, entries in self._entries:
            entries.clear()
        self._body.clear()

    def seal(self, offset: int, compressor: ZstdCompressor) -> SealedChunk:
        """Compress and index the messages, at least one, for a chunk at `offset`, in bytes."""
        packed = compressor.compress(self._body)
        head = chunk_head(self._body, self._entries, len(packed))
        indexes = message_indexes(self._entries)
        return SealedChunk(head + packed + indexes, summarise(head, indexes, offset))


def chunk_head(body: bytes | bytearray, entries: Entries, packed_size: int) -> bytes:
    """Make the part of a chunk's record before the compressed body of `packed_size` bytes."""
    channels = [flat for _, flat in entries if flat]
    return _CHUNK.pack(
        Opcode.CHUNK,
        _CHUNK.size - FRAME.size + packed_size,
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
            parts.append(MESSAGE_INDEX.pack(Opcode.MESSAGE_INDEX, 6 + size, channel, size))
            parts.append(struct.pack(f"<{len(flat)}Q", *flat))
    return b"".join(parts)


def summarise(head: bytes, indexes: bytes, offset: int) -> ChunkSummary:
    """Summarise the chunk at byte `offset` from its first bytes and its message indexes.

    Raises ValueError if these do not fit together.
    """
    try:
        _, length, start, end, size, _, _, _, packed_size = _CHUNK.unpack_from(head)
        chunk_length = FRAME.size + length
        at = 0
        places: list[tuple[int, int]] = []
        counts: list[tuple[int, int]] = []
        while at < len(indexes):
            opcode, length, channel, entries_size = MESSAGE_INDEX.unpack_from(indexes, at)
            if opcode != Opcode.MESSAGE_INDEX or length != 6 + entries_size:
                raise ValueError("a message index does not parse")
            places.append((channel, offset + chunk_length + at))
            counts.append((channel, entries_size // _ENTRY))
            at += FRAME.size + length
    except struct.error as error:
        raise ValueError(f"a chunk or its message index is cut short: {error}") from error
    index = b"".join(
        (
            _CHUNK_INDEX.pack(
                Opcode.CHUNK_INDEX,
                _CHUNK_INDEX.size - FRAME.size + 10 * len(places) + _CHUNK_INDEX_END.size,
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
