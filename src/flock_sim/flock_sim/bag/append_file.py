# SPDX-License-Identifier: Apache-2.0
"""A file that only grows, by blocks that are in it as a whole or not at all."""

import os
import zlib
from pathlib import Path


class AppendFile:
    """A new file; `size` (bytes) and `crc` (CRC-32) are of the whole blocks in it.

    Unbuffered: when `append` returns, the operating system has the block, and a kill -9 of this
    process can't take it back.
    """

    def __init__(self, path: Path) -> None:
        """Make the file; raises OSError, and FileExistsError where there is one already."""
        self.size = 0
        self.crc = 0
        self._fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o666)

    def append(self, block: bytes) -> None:
        """Add a block; when this raises OSError (a full disk), nothing of it stays in the file."""
        view = memoryview(block)
        done = 0
        try:
            # One call, unless the disk fills up within it: the next call tells.
            while done < len(block):
                done += os.pwrite(self._fd, view[done:], self.size + done)
        except OSError:
            os.ftruncate(self._fd, self.size)
            raise
        self.size += done
        self.crc = zlib.crc32(block, self.crc)

    def sync(self) -> None:
        """Wait until the disk itself has the file, safe against a power cut; raises OSError."""
        os.ftruncate(self._fd, self.size)  # an `append` may have failed to clean up
        os.fsync(self._fd)

    def close(self) -> None:
        """Close the file as it is."""
        os.close(self._fd)
