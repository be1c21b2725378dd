# SPDX-License-Identifier: Apache-2.0
"""The meaning of the exit status of a node process: it has failed, or it may be restarted."""

from __future__ import annotations

import signal

STOPPED = 128
"""Exit statuses from here on are 128 + the number of the signal that ended the process."""

WHY = {1: "the run failed", 2: "bad input", 70: "a fault of Flock"}
"""The reasons of the exit statuses of Flock's own errors, and of a fault of Flock."""


def failed(status: int) -> bool:
    """Return whether a process ended with an error, which a restart would only repeat."""
    return 0 < status < STOPPED


def ended(status: int) -> str:
    """Return how a process ended while the flight still needed it, as text after its name."""
    if status == 0:
        return "ended before the flight was over"
    if status > 0:
        return f"ended with status {status}"
    try:
        return f"was killed by {signal.Signals(-status).name}"
    except ValueError:  # a real-time signal
        return f"was killed by signal {-status}"
