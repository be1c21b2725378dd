# SPDX-License-Identifier: Apache-2.0
"""An MCAP chunk with its message indexes, packed and checked by hand for speed."""

import struct
import zlib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np
import numpy.typing as npt
from mcap.opcode import Opcode
from zstandard import ZstdCompressor

from flock_sim.bag.records import FRAME, MESSAGE, MESSAGE_HEAD, MESSAGE_OPCODE

# opcode, length; start and end time (ns), uncompressed size, CRC, compression, compressed size.
_CHUNK = struct.Struct("<BQQQQII4sQ")
CHUNK_HEAD = _CHUNK.size  # bytes
_MESSAGE_INDEX = struct.Struct("<BQHI")  # opcode, length of the rest, channel, bytes of entries
_CHUNK_INDEX = struct.Struct("<BQQQQQI")
_CHUNK_INDEX_END = struct.Struct("<QI4sQQ")
_ENTRY = np.dtype([("time", "<u8"), ("offset", "<u8")])  # of a message, in a message index
_CHANNEL_AT, _TIME_AT = FRAME.size, FRAME.size + 6  # in the record of a message


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

    @property
    def largest(self) -> int:
        """Length of the record of the largest message, in bytes; 0 without messages."""
        starts = sorted(at for _, entries in self._entries for at in entries[1::2])
        ends = [*starts[1:], len(self._body)]
        return (
            max((end - start for start, end in zip(starts, ends)), default=FRAME.size) - FRAME.size
        )

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
            parts.append(_MESSAGE_INDEX.pack(Opcode.MESSAGE_INDEX, 6 + size, channel, size))
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
            opcode, length, channel, entries_size = _MESSAGE_INDEX.unpack_from(indexes, at)
            if opcode != Opcode.MESSAGE_INDEX or length != 6 + entries_size:
                raise ValueError("a message index does not parse")
            places.append((channel, offset + chunk_length + at))
            counts.append((channel, entries_size // _ENTRY.itemsize))
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


def fits(body: bytes, head: bytes, indexes: bytes, packed_size: int) -> bool:
    """Return whether `head` and `indexes` are those that `OpenChunk` makes for this `body`.

    Whole arrays are compared for speed: each resume reads the whole file, which may have millions
    of messages.
    """
    try:
        channels, parts = zip(*_entries(indexes), strict=True)
    except ValueError:
        return False
    entries = np.concatenate(parts)
    channel = np.repeat(channels, [len(part) for part in parts])
    in_order = list(channels) == sorted(set(channels)) and all(
        (np.diff(part["offset"].astype(np.int64)) > 0).all() for part in parts
    )
    last_end = int(entries["offset"].max()) + MESSAGE.size
    if not in_order or last_end > len(body):
        return False
    order = np.argsort(entries["offset"])
    offset, time = entries["offset"][order].astype(np.int64), entries["time"][order]
    data = np.frombuffer(body, np.uint8)
    ends = offset + FRAME.size + _numbers(data, offset + 1, 8)
    times = [(0, [int(time.min()), 0, int(time.max()), 0])]
    return bool(
        np.array_equal(offset, [0, *ends[:-1]])
        and ends[-1] == len(body)
        and (data[offset] == MESSAGE_OPCODE).all()
        and (_numbers(data, offset + _CHANNEL_AT, 2) == channel[order]).all()
        and (_numbers(data, offset + _TIME_AT, 8).astype(np.uint64) == time).all()
        and head == chunk_head(body, times, packed_size)
    )


def _entries(indexes: bytes) -> Iterator[tuple[int, npt.NDArray[np.void]]]:
    """Yield channel and entries of each message index; raises ValueError if one is damaged."""
    at = 0
    while at < len(indexes):
        try:
            _, length, channel, size = _MESSAGE_INDEX.unpack_from(indexes, at)
        except struct.error as error:
            raise ValueError("a message index is cut short") from error
        begin, at = at + _MESSAGE_INDEX.size, at + FRAME.size + length
        if length != _MESSAGE_INDEX.size - FRAME.size + size or not size:
            raise ValueError("a message index has a wrong length")
        yield channel, np.frombuffer(indexes[begin:at], _ENTRY)


def _numbers(
    data: npt.NDArray[np.uint8], at: npt.NDArray[np.int64], size: int
) -> npt.NDArray[np.int64]:
    """Return the little-endian numbers of `size` bytes at the offsets `at`."""
    found: npt.NDArray[np.uint8] = data[at[:, np.newaxis] + np.arange(size)]
    return found.view(np.dtype(f"<u{size}")).ravel().astype(np.int64)
