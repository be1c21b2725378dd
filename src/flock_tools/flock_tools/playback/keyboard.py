# SPDX-License-Identifier: Apache-2.0
"""Reads pressed keys on a terminal. Without a terminal, it gives none."""

from __future__ import annotations

import os
import re
import select
import sys
import termios
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager

SPACE, QUIT = b" ", b"q"
UP, DOWN, RIGHT, LEFT = b"\x1b[A", b"\x1b[B", b"\x1b[C", b"\x1b[D"
_KEY = re.compile(rb"\x1b[\[O][A-D]|.", re.DOTALL)


@contextmanager
def keyboard(begin: Callable[[], None], wanted: bool = True) -> Iterator[Callable[[], list[bytes]]]:
    """Give a function that returns the keys pressed since its last call, without waiting.

    `begin` is called if keys are `wanted` and can be read. The terminal is restored whenever the
    block ends.
    """
    if not (wanted and sys.stdin.isatty() and os.tcgetpgrp(sys.stdin.fileno()) == os.getpgrp()):
        yield list
        return
    terminal = sys.stdin.fileno()
    before = termios.tcgetattr(terminal)
    tty.setcbreak(terminal)
    try:
        begin()
        yield lambda: _pressed(terminal)
    finally:
        termios.tcsetattr(terminal, termios.TCSADRAIN, before)


def _pressed(terminal: int) -> list[bytes]:
    if not select.select([terminal], [], [], 0)[0]:
        return []
    keys = _KEY.findall(os.read(terminal, 256))
    return [key.replace(b"O", b"[") if len(key) == 3 else key for key in keys]
