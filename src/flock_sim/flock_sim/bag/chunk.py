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
_MESSAGE_INDEX = struct.Struct("<BQHI")
_CHUNK_INDEX = struct.Struct("<BQQQQQI")
_CHUNK_INDEX_END = struct.Struct("<QI4sQQ")
_FRAME = 9  # bytes of an opcode and a length


@dataclass(frozen=True)
class SealedChunk:
    """A finished chunk: the bytes for the file, and what the summary will say about it."""

    record: bytes  # the chunk and the message indexes that follow it
    index: bytes  # its ChunkIndex record
    start_time: int  # ns, of its earliest message
    end_time: int  # ns, of its latest message
    counts: tuple[tuple[int, int], ...]  # (channel, messages)


def seal(
    body: bytearray,
    entries: Iterable[tuple[int, list[int]]],
    offset: int,
    compressor: ZstdCompressor,
) -> SealedChunk:
    """Compress `body` and index it, for a chunk that will begin at byte `offset` of the file.

    `body` is a sequence of message records; `entries` gives for each channel the flat list
    [log time, offset in body, log time, offset in body, ...] of its messages, not empty.
    """
    channels = [(channel, flat) for channel, flat in entries if flat]
    start = min(min(flat[::2]) for _, flat in channels)
    end = max(max(flat[::2]) for _, flat in channels)
    packed = compressor.compress(body)
    chunk = _CHUNK.pack(
        Opcode.CHUNK,
        _CHUNK.size - _FRAME + len(packed),
        start,
        end,
        len(body),
        zlib.crc32(body),
        4,
        b"zstd",
        len(packed),
    )
    parts = [chunk, packed]
    chunk_length = len(chunk) + len(packed)
    at = offset + chunk_length
    places: list[tuple[int, int]] = []
    for channel, flat in channels:
        size = 8 * len(flat)
        places.append((channel, at))
        parts.append(_MESSAGE_INDEX.pack(Opcode.MESSAGE_INDEX, 6 + size, channel, size))
        parts.append(struct.pack(f"<{len(flat)}Q", *flat))
        at += _MESSAGE_INDEX.size + size
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
            _CHUNK_INDEX_END.pack(at - offset - chunk_length, 4, b"zstd", len(packed), len(body)),
        )
    )
    counts = tuple((channel, len(flat) // 2) for channel, flat in channels)
    return SealedChunk(b"".join(parts), index, start, end, counts)
