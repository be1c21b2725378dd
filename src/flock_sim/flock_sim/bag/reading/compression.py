# SPDX-License-Identifier: Apache-2.0
"""The compression of rosbag2 on top of MCAP's own: whole files, or the data of every message."""

import os
import tempfile
from io import FileIO
from pathlib import Path
from typing import IO

import zstandard

from flock_sim.bag import limits
from flock_sim.bag.records import DamagedError
from flock_sim.errors import FlockError

FORMAT = "zstd"
"""The only format of rosbag2: its name in metadata.yaml and the suffix of a compressed file."""

ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
"""First bytes of a compressed file or message. No CDR begins with them."""

PIECE = 1 << 20
"""Number of bytes that are unpacked at once."""


def unpacked_file(file: FileIO, path: Path) -> tuple[IO[bytes], str | None]:
    """Unpack a compressed file into a file without a name, which is deleted when it is closed.

    Returns the file, and None or the reason why only a part of it could be unpacked. Raises
    FlockError if the disk has no room, or the file unpacks to more than a genuine bag does.
    """
    largest = max(limits.UNPACKED_SIZE, limits.UNPACKED_RATIO * os.fstat(file.fileno()).st_size)
    unpacked = tempfile.TemporaryFile(buffering=0)  # noqa: SIM115
    damage = None
    try:
        file.seek(0)
        with zstandard.ZstdDecompressor().stream_reader(
            file, read_across_frames=True, closefd=False
        ) as whole:
            while (piece := whole.read(PIECE)) and unpacked.tell() <= largest:
                unpacked.write(piece)
    except zstandard.ZstdError as error:
        damage = f"it does not decompress to its end ({error})"
    except OSError as error:
        unpacked.close()
        raise FlockError(
            f"{path} can't be unpacked in {tempfile.gettempdir()}: {error.strerror}; set TMPDIR to"
            f" a directory with enough space, or unpack it with: zstd -d {path}"
        ) from error
    if (size := unpacked.tell()) > largest:
        unpacked.close()
        raise FlockError(
            f"{path} unpacks to {limits.beyond(size, largest, 'bytes')}: take another copy of the"
            f" bag, or unpack it with: zstd -d {path}"
        )
    return unpacked, damage


def unpacked_message(data: bytes) -> bytes:
    """Return the data of a message that was compressed. Raises DamagedError."""
    try:
        if (size := zstandard.frame_content_size(data)) >= 0:
            _check_message(size)
            return zstandard.ZstdDecompressor().decompress(data)
        reader = zstandard.ZstdDecompressor().stream_reader(data)  # size unknown: piece by piece
        pieces: list[bytes] = []
        while piece := reader.read(PIECE):
            size += len(piece)
            _check_message(size)
            pieces.append(piece)
        return b"".join(pieces)
    except (zstandard.ZstdError, MemoryError) as error:
        raise DamagedError(f"a message in it does not decompress: {error}") from error


def _check_message(size: int) -> None:
    if size > limits.LARGEST_MESSAGE:
        what = limits.beyond(size, limits.LARGEST_MESSAGE, "bytes")
        raise DamagedError(f"a message in it unpacks to {what}")
