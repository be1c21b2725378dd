# SPDX-License-Identifier: Apache-2.0
"""Pushes that were requested in flight, as the recorder keeps them until an epoch begins."""

from __future__ import annotations

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.messages import types as messages
from flock_sim.messages.rejection import FOREIGN, MALFORMED, REPEATED
from flock_sim.protocol.requests import refuses_push
from flock_sim.protocol.session import Session
from flock_sim.recording.flight_writer import Recording

MOST_ASKED = 16
"""Most pushes kept before an epoch begins with them."""


class RequestedPushes:
    """The pushes that no epoch has yet, and those that are on disk, by number."""

    def __init__(self, configuration: FlockConfiguration, run: Recording, session: Session) -> None:
        """Keep the pushes of `session`, and write them to `run`."""
        self._configuration = configuration
        self._run = run
        self._session = session
        self._asked: dict[int, messages.Push] = {}  # by number

    def __contains__(self, number: int) -> bool:
        return number in self._run.live or number in self._asked

    def hear(self, data: bytes) -> str:
        """Keep a push until an epoch begins with it; return why it is rejected, or ""."""
        try:
            push = messages.Push.decode(data)
        except ValueError:
            return MALFORMED
        reason = refuses_push(push, self._configuration, self._run.saved)
        if self._session.run_id not in (0, push.run_id):
            reason = FOREIGN
        if not reason and push.number in self._run.live:
            reason = REPEATED
        if reason:
            return reason
        self._asked[push.number] = push
        if len(self._asked) > MOST_ASKED:
            del self._asked[next(iter(self._asked))]
        return ""

    def write(self, number: int) -> bool:
        """Write the push that an epoch begins with, and drop all others; return whether it did."""
        push = self._asked.pop(number, None)
        self._asked.clear()
        if push is None or push.run_id != self._session.run_id or self._run.closed:
            return False
        self._run.write_perturbation(push)
        return True
