# SPDX-License-Identifier: Apache-2.0
"""Shared memory that ended processes have left behind.

Fast DDS leaves its segments and ports behind when a process is killed, and some of its ports even
when it ends in order. Who uses one holds its lock file: that is how an orphan is told.
"""

from __future__ import annotations

import fcntl
import os
import re
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

SHARED_MEMORY = Path("/dev/shm")
SEGMENT = re.compile(r"fastrtps_([0-9a-f]{16}|port\d+)")
LOCKS = ("_el", "_sl")

UNHELD = 0.2
"""Age, in s, below which a lock file may not be held yet by the process that has made it."""

FIRST_PORT, PORTS = 7400, 250
"""The ports of domain 0 begin here, and each domain has so many."""

YOUNGEST = 2.0
"""Age, in s, below which something that is in use without a lock file may still be in the making.

What nobody uses is not: who writes to somebody dead makes a port without a lock, and leaves it."""


def remove_orphans(directory: Path = SHARED_MEMORY) -> None:
    """Remove the Fast DDS segments and ports in `directory` that no process holds."""
    if not directory.is_dir():
        return
    for name in {match[0] for path in directory.iterdir() if (match := SEGMENT.match(path.name))}:
        orphan = directory / name
        locks = [path for lock in LOCKS if (path := directory / f"{name}{lock}").exists()]
        with suppress(OSError), ExitStack() as held:  # in use, somebody else's, or gone by now
            for lock in locks:
                held.enter_context(_held(lock))
            age = time.time() - (locks[0] if locks else orphan).stat().st_ctime
            ours = _is_ours_alone(name)
            # Asked for only where it matters: it reads the maps of all processes.
            unused = not (locks and ours) and name not in _mapped_by_others()
            if age > (UNHELD if locks or unused else YOUNGEST) and (ours or unused):
                for file in (orphan, directory / f"sem.{name}_mutex", *locks):
                    file.unlink(missing_ok=True)


@contextmanager
def _held(lock: Path) -> Iterator[None]:
    """Hold the file `lock`. Raises BlockingIOError where another process does."""
    descriptor = os.open(lock, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    finally:
        os.close(descriptor)


def _is_ours_alone(name: str) -> bool:
    """Whether no process of another flight may have `name`, or get it, by its number.

    Who ends in order gives up the lock of its port at once, but others may have the port, or its
    mutex, mapped for some time yet. The last of them removes it by its name: had we done so before,
    and had somebody new that name by then, nobody who comes later could reach it. Ports of our own
    domain are ours to remove, and so are segments, whose names nobody has twice.
    """
    _, _, port = name.partition("port")
    first = FIRST_PORT + PORTS * int(os.environ.get("ROS_DOMAIN_ID") or 0)
    return not port or int(port) in range(first, first + PORTS)


def _mapped_by_others() -> set[str]:
    """Return the names of the segments and ports that other processes have mapped."""
    names = set()
    for process in Path("/proc").glob("[0-9]*"):
        if process.name == str(os.getpid()):
            continue
        with suppress(OSError):  # somebody else's, or gone by now
            maps = (process / "maps").read_text(encoding="utf-8", errors="replace")
            names |= {match[0] for match in SEGMENT.finditer(maps)}
    return names
