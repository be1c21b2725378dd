# SPDX-License-Identifier: Apache-2.0
"""Reading of files that users name: regular files of a limited size."""

from __future__ import annotations

from pathlib import Path

from flock_sim.errors import FlockError
from flock_sim.outside.regular_file import read_file

LARGEST_FILE = 64 * 2**20
"""Largest file that is read as a whole, in bytes: span ratios of 501 birds with 10^4 members
have 25 MB."""


def read_bytes(path: Path, called: str) -> bytes:
    """Return the content of a regular file; `called` names its kind in errors.

    Raises FlockError if it is no regular file, is larger than LARGEST_FILE or can't be read.
    """
    try:
        content = read_file(path, LARGEST_FILE)
    except OSError as error:
        raise _unreadable(path, called, error.strerror or str(error)) from error
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
