# SPDX-License-Identifier: Apache-2.0
"""The search for sound chunks in a damaged MCAP file, also after damaged places."""

import os
from collections.abc import Iterator
from itertools import islice
from typing import NamedTuple

from mcap.opcode import Opcode

from flock_sim.bag import limits
from flock_sim.bag.records import (
    CHUNK_TIMES,
    COMPRESSION_AT,
    COMPRESSIONS,
    FRAME,
    ChunkPlace,
    DamagedError,
    read_chunk,
    read_frame,
)

_BLOCK = 1 << 20  # bytes searched at once
_SIZE_AT = FRAME.size + CHUNK_TIMES.size  # of the unpacked size, in bytes from a chunk's frame on
_END_LENGTH = 4  # bytes of the record that ends the data
_IN_DATA = frozenset(
    (
        *(Opcode.HEADER, Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, Opcode.MESSAGE_INDEX),
        *(Opcode.ATTACHMENT, Opcode.METADATA),
    )
)


class SoundChunk(NamedTuple):
    """A chunk with a correct CRC. Without a body: the end of a file that is damaged before it."""

    offset: int  # bytes, of its frame
    body: bytes  # its records
    damage: int | None  # the damaged byte between the chunk before and this one; None: no damage


def sound_chunks(fd: int, offset: int) -> Iterator[SoundChunk]:
    """Yield the sound chunks from byte `offset` of a file on, where a record begins.

    The lengths of records lead from one to the next. If a length is wrong, the next chunk is
    searched for. A torn record at the end of the file counts as damage, since the two can't be
    distinguished. Memory: one chunk. Raises OSError if the file can't be read, and LimitError if
    the search takes too long.
    """
    size = os.fstat(fd).st_size
    search = _Search(fd, size)
    known = offset  # all sound chunks before it were yielded
    damage: int | None = None
    while offset < size:
        frame = read_frame(fd, offset)
        opcode, length = frame or (0, size)
        after = offset + FRAME.size + length
        if opcode == Opcode.DATA_END and length == _END_LENGTH:
            return
        if opcode in _IN_DATA and after <= size:
            offset = after
        elif opcode == Opcode.CHUNK and (body := _body(fd, offset, after)) is not None:
            yield SoundChunk(offset, body, damage)
            known = offset = after
            damage = None
        else:
            damage = offset
            # Not from here: the length that led here may be damaged.
            offset = search.next_chunk(known)
    if damage is not None:
        yield SoundChunk(size, b"", damage)


def goes_on(fd: int, offset: int) -> bool:
    """Return whether a sound chunk follows the damage at byte `offset`.

    A sound chunk at `offset` does not count: its message indexes may be damaged or cut off.
    """
    two = islice(sound_chunks(fd, offset), 2)
    return any(chunk.offset > offset and chunk.body for chunk in two)


def _body(fd: int, offset: int, after: int) -> bytes | None:
    """Return the records of a chunk; None if it is damaged."""
    if _end(fd, offset) != after:
        return None  # its length is wrong: too long or too short for its data
    try:
        return read_chunk(fd, ChunkPlace(offset, after - offset, 0, 0, frozenset()))
    except DamagedError:
        return None


def _end(fd: int, offset: int) -> int:
    """Return the end of a chunk, from the length before its data."""
    at = offset + COMPRESSION_AT
    name_length = int.from_bytes(os.pread(fd, 4, at), "little")
    data_at = at + 4 + name_length + 8
    return data_at + int.from_bytes(os.pread(fd, 8, data_at - 8), "little")


class _Search:
    """The search for the next sound chunk behind damage, of limited work for the whole file."""

    def __init__(self, fd: int, size: int) -> None:
        self._fd = fd
        self._size = size
        self._unpacked = 0  # bytes, of chunks that turned out to be damaged
        self._most = max(limits.SEARCHED_SIZE, limits.SEARCHED_RATIO * size)

    def next_chunk(self, offset: int) -> int:
        """Return the beginning of the next sound chunk from `offset` on; the file's end if none is.

        The search looks for the name of the compression, which has the same offset in all chunks.
        Raises LimitError.
        """
        overlap = COMPRESSION_AT + max(map(len, COMPRESSIONS))
        while offset < self._size:
            block = os.pread(self._fd, _BLOCK + overlap, offset)
            places = sorted(
                place
                for name in COMPRESSIONS
                for place in _places(block, name)
                if place >= COMPRESSION_AT and block[place - COMPRESSION_AT] == Opcode.CHUNK
            )
            for place in places:
                start = offset + place - COMPRESSION_AT
                if self._is_sound(start):
                    return start
            offset += _BLOCK
        return self._size

    def _is_sound(self, start: int) -> bool:
        frame = read_frame(self._fd, start)
        if frame is None:
            return False
        after = start + FRAME.size + frame[1]
        if _body(self._fd, start, after) is not None:
            return True
        if _end(self._fd, start) == after <= self._size:
            unpacked = int.from_bytes(os.pread(self._fd, 8, start + _SIZE_AT), "little")
            self._unpacked += frame[1] + min(unpacked, limits.LARGEST_CHUNK)
            what = "bytes of damaged chunks that overlap"
            limits.check(self._unpacked, self._most, what)
        return False


def _places(block: bytes, name: bytes) -> Iterator[int]:
    at = block.find(name)
    while at >= 0:
        yield at
        at = block.find(name, at + 1)
