# SPDX-License-Identifier: Apache-2.0
"""A block that would never end fails instead."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from typing import NoReturn

DEADLINE = 300
"""Time after which a block counts as hung, in s: a hundred times that of the slowest."""


@contextmanager
def not_hanging() -> Iterator[None]:
    """Raise AssertionError in the block, in the main thread, if it takes DEADLINE s."""

    def end(number: int, frame: object) -> NoReturn:
        raise AssertionError(f"hangs: still runs after {DEADLINE} s")

    before = signal.signal(signal.SIGALRM, end)
    signal.alarm(DEADLINE)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)
