# SPDX-License-Identifier: Apache-2.0
"""A damaged file is kept under another name, and a copy of its sound part takes its place."""

import itertools
import os
from contextlib import suppress
from pathlib import Path

from flock_sim.bag.directory import COPY_FILE, DAMAGED, METADATA_FILE
from flock_sim.bag.writing.storage import AppendFile

_BLOCK = 1 << 20  # bytes copied at once


def put_aside(file: AppendFile, size: int) -> tuple[AppendFile, Path]:
    """Replace `file` by a copy of its first `size` bytes; return the copy and the old file's path.

    Even after a kill, a file with the original name exists, and the old file is complete. The old
    file stays open. Raises OSError, such as for a full disk: nothing has changed then.
    """
    path = file.path
    part = path.with_name(COPY_FILE)
    with suppress(FileNotFoundError):
        part.unlink()
    copy = AppendFile(part)
    try:
        for at in range(0, size, _BLOCK):
            copy.append(os.pread(file.fd, min(_BLOCK, size - at), at))
        copy.sync()
        # metadata.yaml first: its presence says that the bag is complete.
        (path.parent / METADATA_FILE).unlink(missing_ok=True)
        aside = _other_name(path)
        part.replace(path)
    except OSError:
        with suppress(OSError):
            copy.close()
        with suppress(OSError):
            part.unlink()
        raise
    copy.path = path
    return copy, aside


def files_aside(path: Path) -> list[Path]:
    """Return the damaged files that were put aside for the one at `path`."""
    begin = f"{path.name}{DAMAGED}"
    return sorted(entry for entry in path.parent.iterdir() if entry.name.startswith(begin))


def _other_name(path: Path) -> Path:
    """Give the file at `path` a second name; without hard links, rename it."""
    for number in itertools.count(1):
        aside = path.with_name(f"{path.name}{DAMAGED}{f'-{number}' if number > 1 else ''}")
        try:
            aside.hardlink_to(path)
        except FileExistsError:
            if aside.samefile(path):  # a kill came before the copy took its place
                return aside
        except OSError:
            if not aside.exists():
                return path.rename(aside)
        else:
            return aside
    raise AssertionError
