# SPDX-License-Identifier: Apache-2.0
"""Turns of the processes of a machine at making and ending their DDS participants.

A process has a participant from its first node to its last. Two flaws of Fast DDS 2.14 make it
dangerous that one comes or goes while another does:

- Who lets go of a port of its shared memory unlocks the port's file first, and removes it by its
  name then. Somebody who looks for a free port in between finds it unlocked, makes it anew, and has
  it removed: nobody who comes later can reach him.
- Who ends its participant while the participant is told of another's end waits for ever, at full
  speed, and lets nobody have what he waits for (eProsima/Fast-DDS issue 6513).

Participants of other software take no turns. Between theirs and ours both remain possible.
"""

from __future__ import annotations

import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager

from flock_sim.claims import claimed

PATIENCE = 10.0
"""Time, in s, after which one goes on without a turn: who has it may have been suspended."""

POLL = 0.002
"""Time, in s, between two looks whether the turn is free."""


@contextmanager
def turn() -> Iterator[None]:
    """Make or end a participant in the block, while no other process of ours does."""
    with socket.socket(socket.AF_UNIX) as claim:
        deadline = time.monotonic() + PATIENCE
        while not claimed(claim, "participant") and time.monotonic() < deadline:
            time.sleep(POLL)
        yield
