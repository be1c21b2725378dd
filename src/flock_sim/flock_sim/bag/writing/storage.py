# SPDX-License-Identifier: Apache-2.0
"""The storage of a bag: a file that grows by whole blocks, and reserved space to finish it."""

import errno
import os
import zlib
from contextlib import suppress
from pathlib import Path

from flock_sim.bag.lock import lock
from flock_sim.bag.records import crc_of

_STEP = 64 * 1024  # bytes of reserved space; grows rarely, so that a chunk rarely pays for it
_UNKNOWN = -1  # in place of a modification time, in ns


class LostError(OSError):
    """The file is not as it was written: another process has removed or changed it."""

    def __init__(self, words: str) -> None:
        super().__init__(errno.ESTALE, words)


class AppendFile:
    """A file with one writer; `size` (bytes) and `crc` (CRC-32) are those of its whole blocks.

    The file is unbuffered: when `append` returns, the block was handed to the operating system, and
    a kill -9 of this process can't undo it. Code that renames the file must also set `path`.
    """

    def __init__(self, path: Path, *, existing: bool = False) -> None:
        """Make the file or, with `existing`, open an existing one, which must first be `cut`.

        Raises OSError: FileExistsError if a new file already exists, BlockingIOError while another
        process is writing to it.
        """
        self.path = path
        self.size = 0
        self.crc = 0
        flags = 0 if existing else os.O_CREAT | os.O_EXCL
        self.fd = os.open(path, os.O_RDWR | os.O_CLOEXEC | flags, 0o666)
        try:
            lock(self.fd)
            self._modified = os.fstat(self.fd).st_mtime_ns
        except OSError:
            with suppress(OSError):
                os.close(self.fd)
            if not existing:
                with suppress(OSError):
                    path.unlink()
            raise
        self._times_tell = True
        """Whether the modification time of the file is reliable on this file system."""

    def cut(self, size: int, crc: int) -> None:
        """Keep the first `size` bytes, whose CRC-32 is `crc`; raises OSError."""
        os.ftruncate(self.fd, size)
        self.size, self.crc = size, crc
        self._note_time()

    def append(self, block: bytes) -> None:
        """Append a block. If this raises OSError (full disk), no part of it counts as written.

        The part that was written is cut off, at the latest by `sync`.
        """
        view = memoryview(block)
        crc = zlib.crc32(block, self.crc)
        done = 0
        try:
            # Usually one call. If the disk fills up, it writes a part, and the next call raises.
            while done < len(block):
                done += os.pwrite(self.fd, view[done:], self.size + done)
        except OSError:
            with suppress(OSError):
                os.ftruncate(self.fd, self.size)
            self._note_time()
            raise
        # Ctrl-C can't separate the two assignments: there is no call between them.
        self.size, self.crc = self.size + done, crc
        self._note_time()

    def check(self, *, thorough: bool = False) -> None:
        """Raise LostError unless the file is at `path` and unchanged.

        Its contents are read again if its modification time changed, or if `thorough`: clocks of
        file systems are too coarse to show a foreign write just after one of ours. Raises OSError
        if it can't be read.
        """
        ours = os.fstat(self.fd)
        try:
            there = os.stat(self.path)
        except (FileNotFoundError, NotADirectoryError):
            raise LostError("it was removed or moved") from None
        if (there.st_dev, there.st_ino) != (ours.st_dev, ours.st_ino):
            raise LostError("another file is in its place")
        if ours.st_size < self.size:
            raise LostError(f"it was cut to {ours.st_size} of its {self.size} bytes")
        changed = ours.st_mtime_ns != self._modified
        if (changed and self._times_tell) or thorough:
            if crc_of(self.fd, self.size) != self.crc:
                raise LostError("another process has written to it")
            self._times_tell = not changed or ours.st_size > self.size
            self._modified = ours.st_mtime_ns

    def sync(self) -> None:
        """Wait until the file is on the disk, safe against a power cut; raises OSError."""
        os.ftruncate(self.fd, self.size)  # an `append` may have failed to clean up
        self._note_time()
        os.fsync(self.fd)

    def close(self) -> None:
        """Close the file as it is.

        Raises OSError if the file system reports now that what was written before is not stored.
        """
        os.close(self.fd)

    def _note_time(self) -> None:
        """Note the modification time; without it, the next `check` reads the contents."""
        self._modified = _UNKNOWN
        with suppress(OSError):
            self._modified = os.fstat(self.fd).st_mtime_ns


class Reserve:
    """Reserved disk space, so that a bag can be finished after the disk has filled up.

    It is a file of allocated, unused space: `hold` before the space is needed, `free` to use it.
    """

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
        """Free the space; does nothing if there is none, or if the file is another process's.

        Space that can't be freed is missed by the next `append` to a full disk, if any.
        """
        with suppress(OSError):
            status = os.stat(self.path)
            if (status.st_dev, status.st_ino) == self._file:
                self.path.unlink()
        self._held = 0
