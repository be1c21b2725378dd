# SPDX-License-Identifier: Apache-2.0
"""A file that only grows, by blocks that are in it as a whole or not at all."""

import fcntl
import os
import zlib
from pathlib import Path


class AppendFile:
    """A file of one writer; `size` (bytes) and `crc` (CRC-32) are of the whole blocks in it.

    Unbuffered: when `append` returns, the operating system has the block, and a kill -9 of this
    process can't take it back.
    """

    def __init__(self, path: Path, *, existing: bool = False) -> None:
        """Make the file or, with `existing`, open the one there is: to `cut` it comes first.

        Raises OSError: FileExistsError where a new file is there already, BlockingIOError while
        another process is writing to it.
        """
        self.size = 0
        self.crc = 0
        flags = 0 if existing else os.O_CREAT | os.O_EXCL
        self.fd = os.open(path, os.O_RDWR | os.O_CLOEXEC | flags, 0o666)
        try:
            _lock(self.fd)
        except OSError:
            os.close(self.fd)
            raise

    def cut(self, size: int, crc: int) -> None:
        """Keep the first `size` bytes, whose CRC-32 is `crc`; raises OSError."""
        os.ftruncate(self.fd, size)
        self.size, self.crc = size, crc

    def append(self, block: bytes) -> None:
        """Add a block; when this raises OSError (a full disk), nothing of it stays in the file."""
        view = memoryview(block)
        crc = zlib.crc32(block, self.crc)
        done = 0
        try:
            # One call, unless the disk fills up within it: the next call tells.
            while done < len(block):
                done += os.pwrite(self.fd, view[done:], self.size + done)
        except OSError:
            os.ftruncate(self.fd, self.size)
            raise
        # Both or none, whenever Ctrl-C comes: no call lies between them.
        self.size, self.crc = self.size + done, crc

    def sync(self) -> None:
        """Wait until the disk itself has the file, safe against a power cut; raises OSError."""
        os.ftruncate(self.fd, self.size)  # an `append` may have failed to clean up
        os.fsync(self.fd)

    def close(self) -> None:
        """Close the file as it is."""
        os.close(self.fd)


def _lock(fd: int) -> None:
    """Keep other writers off until the file is closed, be it by the end of this process."""
    try:
        fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        raise BlockingIOError(error.errno, "another process is writing to it") from error
    except OSError:
        return  # a file system that knows no locks
