# SPDX-License-Identifier: Apache-2.0
"""Reading of files that users name: regular files of a limited size."""

from __future__ import annotations

import os
import stat
from pathlib import Path

from flock_sim.errors import FlockError

LARGEST_FILE = 64 * 2**20
"""Largest file that is read as a whole, in bytes: span ratios of 501 birds with 10^4 members
have 25 MB."""

_KINDS = {
    stat.S_IFDIR: "Is a directory",
    stat.S_IFIFO: "is a named pipe, which has no end",
    stat.S_IFCHR: "is a device, which has no end",
    stat.S_IFBLK: "is a device",
    stat.S_IFSOCK: "is a socket",
}


def read_bytes(path: Path, called: str) -> bytes:
    """Return the content of a regular file; `called` names its kind in errors.

    Raises FlockError if it is no regular file, is larger than LARGEST_FILE or can't be read.
    """
    try:
        # Without O_NONBLOCK, the call waits for a writer if the file is a named pipe.
        file = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
        with open(file, "rb") as opened:
            kind = stat.S_IFMT(os.fstat(file).st_mode)
            if kind != stat.S_IFREG:
                raise _unreadable(path, called, _KINDS.get(kind, "is no regular file"))
            content = opened.read(LARGEST_FILE + 1)  # files of /proc do not tell their size
    except OSError as error:
        raise _unreadable(path, called, error.strerror or str(error)) from error
    except ValueError as error:  # a null character in the name, or a surrogate
        raise _unreadable(path, called, f"its name is invalid ({error})") from error
    if len(content) > LARGEST_FILE:
        most = f"{LARGEST_FILE // 2**20} MiB"
        raise FlockError(f"{called} {path}: is larger than {most}, the limit; make it smaller")
    return content


def read_text(path: Path, called: str) -> str:
    """Return the UTF-8 text of a file. Raises FlockError as `read_bytes`, or if it is no text."""
    content = read_bytes(path, called)
    try:
        return content.decode("utf-8-sig")  # some editors begin a text with a byte order mark
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise _unreadable(path, called, f"it is not UTF-8 text (line {line})") from error


def _unreadable(path: Path, called: str, reason: str) -> FlockError:
    return FlockError(f"{called} {path}: {reason}; name a readable {called}")
