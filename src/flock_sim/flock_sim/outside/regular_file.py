# SPDX-License-Identifier: Apache-2.0
"""Opening of files from outside: regular files only, which have an end."""

from __future__ import annotations

import os
import stat
from io import BufferedReader, FileIO
from pathlib import Path

_KINDS = {
    stat.S_IFDIR: "Is a directory",
    stat.S_IFIFO: "is a named pipe, which has no end",
    stat.S_IFCHR: "is a device, which has no end",
    stat.S_IFBLK: "is a device",
    stat.S_IFSOCK: "is a socket",
}


class NotRegularError(OSError):
    """A path leads to something else than a regular file; `strerror` says what it is."""

    def __init__(self, mode: int) -> None:
        super().__init__(0, _KINDS.get(stat.S_IFMT(mode), "is no regular file"))


def open_file(path: Path) -> FileIO:
    """Open a regular file for reading. Raises OSError, of type NotRegularError for other files."""
    try:
        # Without O_NONBLOCK, the call waits for a writer if the file is a named pipe.
        file = FileIO(path, opener=lambda name, flags: os.open(name, flags | os.O_NONBLOCK))
    except IsADirectoryError as error:
        raise NotRegularError(stat.S_IFDIR) from error
    except ValueError as error:  # a null character in the name, or a surrogate
        raise OSError(0, f"its name is invalid ({error})") from error
    mode = os.fstat(file.fileno()).st_mode
    if not stat.S_ISREG(mode):
        file.close()
        raise NotRegularError(mode)
    return file


def read_file(path: Path, most: int) -> bytes:
    """Return the content of a regular file, or `most` + 1 bytes of a larger one. Raises OSError."""
    with BufferedReader(open_file(path)) as file:
        return file.read(most + 1)  # files of /proc do not tell their size
