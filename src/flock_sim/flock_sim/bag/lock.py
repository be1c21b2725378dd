# SPDX-License-Identifier: Apache-2.0
"""Locks that give one process access to a bag. A lock ends with the process that holds it."""

import fcntl
import os
from pathlib import Path


def lock(fd: int) -> None:
    """Lock an open file or directory until it is closed, at the latest when this process ends.

    Raises BlockingIOError while another process has the lock.
    """
    try:
        fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        raise BlockingIOError(error.errno, "another process is writing to it") from error
    except OSError:
        return  # a file system without locks


def is_locked(path: Path) -> bool:
    """Return whether another process has the lock of a file; False if it can't be read."""
    for access in (os.O_RDWR, os.O_RDONLY):  # some file systems lock only files open for writing
        try:
            # Without O_NONBLOCK, the call waits for a writer if the file is a named pipe.
            fd = os.open(path, access | os.O_CLOEXEC | os.O_NONBLOCK)
        except OSError:
            continue
        try:
            lock(fd)
        except BlockingIOError:
            return True
        finally:
            os.close(fd)
        return False
    return False
