# SPDX-License-Identifier: Apache-2.0
"""What is in an MCAP file without a sound summary, found by going from record to record."""

import os
from contextlib import suppress

from mcap.opcode import Opcode

from flock_sim.bag.chunk import MESSAGE, MESSAGE_FIELDS
from flock_sim.bag.contents import Contents
from flock_sim.bag.frames import (
    CHUNK_TIMES,
    FRAME,
    ChunkPlace,
    DamagedError,
    read_chunk,
    read_content,
    read_frame,
    records_in,
)
from flock_sim.bag.layout import MAGIC

_DEFINING = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.METADATA)


def scanned(fd: int) -> Contents:
    """Read the contents up to the last record that is whole.

    Chunks at the end that are damaged are left out. `missing` tells how many bytes of data are
    not used, or is None. Reads no chunk but the last, unless chunks bring their own definitions.
    """
    size = os.fstat(fd).st_size
    contents = Contents(whole=len(MAGIC))
    data_end = _walk(fd, size, contents)
    _drop_damaged_tail(fd, contents)
    _learn_from_chunks(fd, contents)
    for place in contents.chunks:
        contents.meet(place.end_time)
    lost = data_end - contents.whole
    if lost:
        contents.missing = f"the last {lost} bytes of data are not whole and are left out"
    return contents


def _walk(fd: int, size: int, contents: Contents) -> int:
    """Take in the records as far as they are whole; returns where the data should end."""
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
                contents.define(opcode, read_content(fd, offset, length))
            elif opcode == Opcode.CHUNK and length >= CHUNK_TIMES.size:
                start, end = CHUNK_TIMES.unpack(read_content(fd, offset, CHUNK_TIMES.size))
                place = ChunkPlace(offset, FRAME.size + length, start, end, frozenset())
                contents.chunks.append(place)
            elif opcode == Opcode.MESSAGE_INDEX and contents.chunks:
                channel = read_content(fd, offset, min(length, 2))
                indexed.add(int.from_bytes(channel, "little"))
            elif opcode == Opcode.MESSAGE and length >= MESSAGE_FIELDS:
                head = FRAME.pack(opcode, length) + read_content(fd, offset, MESSAGE_FIELDS)
                contents.meet(MESSAGE.unpack(head)[4])
                contents.loose = True
            contents.whole = after
    return size


def _drop_damaged_tail(fd: int, contents: Contents) -> None:
    """Leave out chunks at the end that a power cut kept from being written out as a whole."""
    while contents.chunks:
        try:
            read_chunk(fd, contents.chunks[-1])
            return
        except DamagedError:
            contents.whole = contents.chunks.pop().offset


def _learn_from_chunks(fd: int, contents: Contents) -> None:
    """Find the definitions that are nowhere but in chunks, as most writers but ours place them."""
    for place in contents.chunks:
        if not place.channels or not place.channels <= contents.channels.keys():
            with suppress(DamagedError):  # told when its messages are read
                for opcode, content in records_in(read_chunk(fd, place)):
                    contents.define(opcode, content)
