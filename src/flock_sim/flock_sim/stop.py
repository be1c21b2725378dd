# SPDX-License-Identifier: Apache-2.0
"""How a node process learns that it is to end."""

from __future__ import annotations

import signal


class Stop:
    """Whether somebody wants this process to end: Ctrl-C, or a polite kill.

    A flag rather than an exception, so that nothing is cut off half way; the loops of the nodes
    look at it. The ROS context stays valid, so that what is on its way can still be sent.
    """

    def __init__(self, heed_interrupt: bool) -> None:
        """Listen to SIGTERM, SIGHUP and, with `heed_interrupt`, to SIGINT."""
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
        """What a shell expects of a process that ended for this reason; 0 without one."""
        return 128 + self.signal if self else 0

    def _hear(self, number: int, frame: object) -> None:
        self.signal = number
