# SPDX-License-Identifier: Apache-2.0
"""Signals that end a process."""

from __future__ import annotations

import atexit
import ctypes
import math
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NoReturn, Self

ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""Signals by which users and systems end a process in order."""


INSISTENCE = 5.0
"""Time after a signal before the next one has an effect, in s."""

SUPERVISED = "FLOCK_SUPERVISED"
"""Environment variable of supervised processes: the process id of their parent."""

PR_SET_PDEATHSIG = 1


def end_with_parent() -> None:
    """Request a SIGTERM for this process when its parent ends for any reason; on Linux only."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGTERM)


def end_process(status: int) -> NoReturn:
    """End this process as Python does, but leave its memory to the system.

    To free the memory of numba and rclpy takes 0.1 s. The exit handlers of C libraries must not run
    in a fork of the process that loaded them.
    """
    threading._shutdown()  # type: ignore[attr-defined]
    atexit._run_exitfuncs()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(status)


class Ended(KeyboardInterrupt):
    """A signal ends this tool; `status` is the exit status that a shell expects."""

    def __init__(self, number: int) -> None:
        """Store the signal."""
        super().__init__(number)
        self.status = 128 + number


class Endings:
    """Ends the block at the first signal of ENDING, in order: it raises Ended.

    Signals that follow within INSISTENCE s are ignored: they would interrupt the orderly end, and
    change the exit status. It works in the main thread; in other threads it has no effect.
    """

    def __init__(self) -> None:
        self._first = -math.inf
        self._deferred = False
        self._number = 0
        self._before: dict[int, Any] = {}

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():
            for number in ENDING:
                # A signal that the parent process ignores stays ignored, as with nohup.
                if signal.getsignal(number) is not signal.SIG_IGN:
                    self._before[number] = signal.signal(number, self._hear)
        return self

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        ended = isinstance(error, Ended)
        for number, handler in self._before.items():
            # A second Ctrl-C must not disturb the code after the block, either.
            signal.signal(number, signal.SIG_IGN if ended else handler)

    @contextmanager
    def deferred(self) -> Iterator[None]:
        """In the block, raise in `check` only: an exception in a callback of C++ may be lost."""
        self._deferred = True
        try:
            yield
        finally:
            self._deferred = False

    def check(self) -> None:
        """Raise Ended if a signal has come."""
        if self._number:
            raise Ended(self._number)

    def _hear(self, number: int, frame: object) -> None:
        now = time.monotonic()
        if now - self._first < INSISTENCE:
            return
        self._first = now
        self._number = self._number or number
        if not self._deferred:
            raise Ended(self._number)


class Stop:
    """Whether a signal has requested the end of this process: SIGINT, SIGTERM or SIGHUP.

    It is a flag, not an exception, so that no work is interrupted half way; the loops of the nodes
    check it. The ROS context stays valid, so that queued messages can still be sent.
    """

    def __init__(self, heed_interrupt: bool) -> None:
        """Handle SIGTERM, SIGHUP and, with `heed_interrupt`, SIGINT."""
        self.signal = 0
        for number in (
            signal.SIGTERM,
            signal.SIGHUP,
            *((signal.SIGINT,) if heed_interrupt else ()),
        ):
            signal.signal(number, self._hear)

    def __bool__(self) -> bool:
        return self.signal != 0

    @property
    def exit_status(self) -> int:
        """Exit status that a shell expects after this signal; 0 without a signal."""
        return 128 + self.signal if self else 0

    def _hear(self, number: int, frame: object) -> None:
        self.signal = number


@contextmanager
def ending_deferred() -> Iterator[None]:
    """Handle signals that end this process only after the block.

    An exception of a handler during a fork is lost, and a process that was started but not stored
    would never be ended. Processes that are started in the block inherit a blocked SIGINT. Without
    that, they would print errors of interrupted imports before their own code ignores SIGINT.
    """
    heard: list[int] = []
    handlers = {number: signal.getsignal(number) for number in ENDING}
    for number in ENDING:
        signal.signal(number, lambda number, frame: heard.append(number))
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        for number, handler in handlers.items():
            signal.signal(number, handler)
    for one in heard:
        os.kill(os.getpid(), one)  # Python calls the handler before the next line
