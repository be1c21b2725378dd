# SPDX-License-Identifier: Apache-2.0
"""The file that a tool writes its result to, named by --output."""

from __future__ import annotations

import os
from pathlib import Path

from flock_sim.errors import FlockError


def check_output(output: Path, option: str = "--output") -> None:
    """Refuse a file that can't be written, before anything is computed. Raises FlockError.

    `option` is what it was named by.
    """
    if output.is_dir():
        raise FlockError(f"{option} {output}: is a directory; name a file in it")
    if not output.parent.is_dir():
        raise FlockError(f"{option} {output}: can't be written: {output.parent} is no directory")
    if not os.access(output if output.exists() else output.parent, os.W_OK):
        raise FlockError(f"{option} {output}: can't be written: Permission denied")


def write_output(output: Path, content: bytes | memoryview, option: str = "--output") -> None:
    """Write `content`. Raises FlockError where it can't be."""
    try:
        output.write_bytes(content)
    except OSError as error:
        raise FlockError(f"{option} {output}: can't be written: {error.strerror}") from error
