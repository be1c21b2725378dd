# SPDX-License-Identifier: Apache-2.0
"""Checks that the head and the message indexes of a chunk are those that `BagWriter` writes."""

import struct
from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from flock_sim.bag.chunk import MESSAGE_INDEX, chunk_head
from flock_sim.bag.records import FRAME, MESSAGE, MESSAGE_OPCODE

_CHANNEL_AT, _TIME_AT = FRAME.size, FRAME.size + 6  # in a message's record
_ENTRY = np.dtype([("time", "<u8"), ("offset", "<u8")])


def fits(body: bytes, head: bytes, indexes: bytes, packed_size: int) -> bool:
    """Return whether `head` and `indexes` are those of a chunk with the messages in `body`.

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
            _, length, channel, size = MESSAGE_INDEX.unpack_from(indexes, at)
        except struct.error as error:
            raise ValueError("a message index is cut short") from error
        begin, at = at + MESSAGE_INDEX.size, at + FRAME.size + length
        if length != MESSAGE_INDEX.size - FRAME.size + size or not size:
            raise ValueError("a message index has a wrong length")
        yield channel, np.frombuffer(indexes[begin:at], _ENTRY)


def _numbers(
    data: npt.NDArray[np.uint8], at: npt.NDArray[np.int64], size: int
) -> npt.NDArray[np.int64]:
    """Return the little-endian numbers of `size` bytes at the offsets `at`."""
    found: npt.NDArray[np.uint8] = data[at[:, np.newaxis] + np.arange(size)]
    return found.view(np.dtype(f"<u{size}")).ravel().astype(np.int64)
