# SPDX-License-Identifier: Apache-2.0
"""Check that this process can be forked: a fork copies one thread, but the locks of all."""

from __future__ import annotations

import os
import re
import threading
import time
from pathlib import Path

LTTNG_WAIT = b"/dev/shm/lttng-ust-wait"
FUTEX = str({"x86_64": 202, "aarch64": 98}.get(os.uname().machine))
SETTLE = 0.2
"""Longest wait for LTTng's threads to detect that no session daemon runs, in s."""


class CannotFork(Exception):
    """This process must not be forked, or this system lacks what the fork server needs."""


def check_system() -> None:
    """Raise CannotFork if the system lacks pidfd_open (it exists since Linux 5.3)."""
    if not hasattr(os, "pidfd_open"):
        raise CannotFork("this Python has no os.pidfd_open")
    try:
        os.close(os.pidfd_open(os.getpid()))
    except OSError as error:
        raise CannotFork(f"this kernel has no pidfd_open: {error}") from error


def check_forkable() -> None:
    """Raise CannotFork if this process has other threads than this one and LTTng's.

    rclpy loads LTTng's tracing library, which starts two threads. If no session daemon runs, they
    wait for one, at an address that the library has mapped for this, and hold no lock.
    """
    check_system()
    deadline = time.monotonic() + SETTLE
    while others := _threads_at_work():
        if time.monotonic() > deadline:
            raise CannotFork(f"this process has other threads: {others}")
        time.sleep(0.002)  # no event signals that a thread of LTTng waits


def _threads_at_work() -> list[str]:
    """Return the ids of all threads but this one and waiting threads of LTTng."""
    tasks = Path("/proc/self/task")
    others = [t.name for t in tasks.iterdir() if t.name != str(threading.get_native_id())]
    if not others:
        return []
    lines = Path("/proc/self/maps").read_bytes().split(b"\n")  # paths may be of any encoding
    waits = {int(line.split(b"-")[0], 16) for line in lines if LTTNG_WAIT in line}
    return [thread for thread in others if not _waits_at(tasks / thread / "syscall", waits)]


def _waits_at(syscall: Path, addresses: set[int]) -> bool:
    try:
        match = re.match(rf"{FUTEX} 0x([0-9a-f]+) ", syscall.read_text(encoding="ascii"))
    except OSError:
        return False
    return match is not None and int(match[1], 16) in addresses
