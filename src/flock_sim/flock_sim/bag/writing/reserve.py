# SPDX-License-Identifier: Apache-2.0
"""Reserved disk space, so that a bag can be finished after the disk has filled up."""

import os
from contextlib import suppress
from pathlib import Path

_STEP = 64 * 1024  # bytes; grows rarely, so that a chunk rarely pays for it


class Reserve:
    """A file of allocated, unused space: `hold` before the space is needed, `free` to use it."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._held = 0  # bytes
        self._file = (0, 0)  # device and inode

    def hold(self, size: int) -> None:
        """Keep at least `size` bytes allocated; raises OSError if the disk has no room."""
        if size <= self._held:
            return
        wanted = -(-size // _STEP) * _STEP
        fd = os.open(self.path, os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC, 0o666)
        try:
            status = os.fstat(fd)
            self._file = (status.st_dev, status.st_ino)
            os.posix_fallocate(fd, 0, wanted)
        finally:
            os.close(fd)
        self._held = wanted

    def free(self) -> None:
        """Free the space; does nothing if there is none, or if the file is another process's."""
        with suppress(FileNotFoundError, NotADirectoryError):
            status = os.stat(self.path)
            if (status.st_dev, status.st_ino) == self._file:
                self.path.unlink()
        self._held = 0
