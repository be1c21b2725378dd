# SPDX-License-Identifier: Apache-2.0
"""The contents of an MCAP file without a sound summary, found by a pass over its records."""

import os
from contextlib import suppress

from mcap.opcode import Opcode

from flock_sim.bag.chunk import MESSAGE, MESSAGE_FIELDS
from flock_sim.bag.file_sections import MAGIC
from flock_sim.bag.index import Contents
from flock_sim.bag.records import (
    CHUNK_TIMES,
    FRAME,
    ChunkPlace,
    DamagedError,
    read_chunk,
    read_content,
    read_frame,
    records_in,
)
from flock_sim.bag.salvage import goes_on

_DEFINING = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.METADATA)


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
            " data from there on"
        )
    elif lost:
        contents.missing = f"the last {lost} bytes of data are not whole and are left out"
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
    """Leave out chunks at the end that were not completely written because of a power cut."""
    while contents.chunks:
        try:
            read_chunk(fd, contents.chunks[-1])
            return
        except DamagedError:
            contents.whole = contents.chunks.pop().offset


def _learn_from_chunks(fd: int, contents: Contents) -> None:
    """Find definitions that are only in chunks, where most other writers place them."""
    for place in contents.chunks:
        if not place.channels or not place.channels <= contents.channels.keys():
            with suppress(DamagedError):  # reported when its messages are read
                for opcode, content in records_in(read_chunk(fd, place)):
                    contents.define(opcode, content)
