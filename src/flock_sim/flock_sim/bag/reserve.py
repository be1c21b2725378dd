# SPDX-License-Identifier: Apache-2.0
"""Disk space held back, so that a bag can be finished after the disk has filled up."""

import os
from contextlib import suppress
from pathlib import Path

_STEP = 64 * 1024  # bytes; grows rarely, so that a chunk rarely pays for it

RESERVE_FILE = ".reserve"


class Reserve:
    """A file of allocated, unused space: `hold` before the space is needed, `free` to use it."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._held = 0  # bytes

    def hold(self, size: int) -> None:
        """Keep at least `size` bytes allocated; raises OSError where the disk has no room."""
        if size <= self._held:
            return
        wanted = -(-size // _STEP) * _STEP
        fd = os.open(self.path, os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC, 0o666)
        try:
            os.posix_fallocate(fd, 0, wanted)
        finally:
            os.close(fd)
        self._held = wanted

    def free(self) -> None:
        """Give the space back; does nothing when there is none."""
        with suppress(FileNotFoundError):
            self.path.unlink()
        self._held = 0
