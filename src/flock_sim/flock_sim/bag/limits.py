# SPDX-License-Identifier: Apache-2.0
"""The limits within which bags are read, whatever their files state.

They are far above those of genuine bags: a bag of 100 GB with a million chunks is within them.
"""

from __future__ import annotations

import os

from flock_sim.errors import FlockError

MIB, GIB = 2**20, 2**30

LARGEST_CHUNK = GIB // 2
"""Largest size of a chunk, packed or unpacked, in bytes; writers end one after some MB. A row of
states of 501 birds in 10^4 members, which is in one chunk, has 250 MB."""

LARGEST_MESSAGE = GIB // 4
"""Largest size of a message, packed or unpacked, in bytes. With LARGEST_CHUNK, a tool holds 1 GiB
at most: a chunk, the message that it works on, and the next one."""

LARGEST_SUMMARY = 2 * 10**9
"""Largest summary, in bytes; 2 * 10^9 is 10^6 chunks with 190 topics each. os.pread reads at most
2^31 - 4096 bytes."""

LARGEST_DEFINITION = 128 * MIB
"""Largest schema, channel or metadata record, in bytes. The span ratios of 501 birds in 10^4
members have 25 MB."""

DEFINITIONS_SIZE = 256 * MIB
"""Largest size of all these records of a file, in bytes. Equal copies count once."""

MOST_DEFINITIONS = 2**18
"""Largest number of these records in a file. MCAP has 2^16 numbers for channels, and for schemas.
"""

MOST_CHUNKS = 4_000_000
"""Largest number of chunks in a file; each takes some 200 bytes of memory."""

MOST_INDEXED = 10**7
"""Largest number of channels in the remembered sets of channels of chunks."""

MOST_FILES = 10_000
"""Largest number of files in a bag."""

LARGEST_METADATA_FILE = 16 * MIB
"""Largest metadata.yaml, and largest copy of it in a file of rosbag2, in bytes."""

LARGEST_PROFILES = MIB
"""Largest text of the QoS profiles of a channel, in bytes: those of 2000 publishers."""

MOST_METADATA_VALUES = 2_000_000
"""Largest number of values in a metadata.yaml; rosbag2 writes 14 for a file, and 50 for a topic."""

OVERLAP = GIB // 2
"""Largest size of messages that are kept at a time, such as while they are ordered by time, in
bytes."""

MESSAGE_COST = 256
"""Size that is added for each of these messages, in bytes: that of its Python objects."""

UNPACKED_SIZE, UNPACKED_RATIO = GIB, 1000
"""A file that rosbag2 compressed may unpack to this size in bytes, and a larger one to so many
times its size."""

CHUNKS_SIZE, CHUNKS_RATIO = 4 * GIB, 10_000
"""The same for all chunks of a file together, each time that they are read: otherwise a file of
1 MB can keep a tool busy for hours. A flight of 10^4 equal members has a ratio of some thousand."""

SEARCHED_SIZE, SEARCHED_RATIO = 4 * GIB, 16
"""Size in bytes of damaged chunks that are unpacked in a search for the next sound one. In a larger
file it is so many times the size of the file."""


class LimitError(FlockError):
    """A file exceeds a limit; the text follows the name of the file."""


def check(value: int, limit: int, what: str) -> None:
    """Raise LimitError if `value`, a number of `what`, is above `limit`."""
    if value > limit:
        raise LimitError(f"has {beyond(value, limit, what)}")


class Unpacked:
    """The unpacked size of the chunks of a file that are read in one pass."""

    def __init__(self, fd: int) -> None:
        self._size = 0
        self._most = max(CHUNKS_SIZE, CHUNKS_RATIO * os.fstat(fd).st_size)

    def add(self, size: int) -> None:
        """Add the size of a chunk, in bytes. Raises LimitError if all are too large."""
        self._size += size
        check(self._size, self._most, "unpacked bytes in its chunks")


def beyond(value: int, limit: int, what: str) -> str:
    """Return the words on a number of `what` that is above its limit."""
    return f"{value} {what}, more than the limit of {limit}"
