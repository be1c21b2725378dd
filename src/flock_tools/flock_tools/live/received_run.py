# SPDX-License-Identifier: Apache-2.0
"""The messages of one run, as far as a listener has received and kept them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.errors import FlockError
from flock_sim.messages.handshake import read_handshake
from flock_sim.messages.types import Grant, State, Wing

MOST_ROWS = 256
"""Largest number of steps that are kept while some of their states are missing."""


@dataclass(frozen=True)
class Granted:
    """The last grant of a run, and what its clock flies."""

    grant: Grant
    at: float
    """When it was received, in s."""
    configuration: FlockConfiguration | None
    real_time_factor: float
    """That of a free flight; 0 in lockstep."""
    unreadable: str = ""
    """Why this version of Flock can't read the configuration; empty if it can."""


class _Received(NamedTuple):
    """A state, and when it was received and sent, in s."""

    state: State
    at: float
    sent: float


class Row(NamedTuple):
    """The states of birds 1 to N at one step, and when the first one was sent, in s.

    That is always the state of bird 1, since each host has its own clock.
    """

    states: list[State]
    sent: float


class ReceivedRun:
    """The grant, the wings and the latest states of one run. Recorded states are those of run 0."""

    def __init__(self) -> None:
        """Start without messages."""
        self.granted: Granted | None = None
        self.wings: dict[int, tuple[Wing, float]] = {}
        """The wing of each bird, and when it was received, in s."""
        self.heard: dict[int, float] = {}
        """When the last state of each bird was received, in s."""
        self.sent: dict[int, float] = {}
        """When it was sent, in s."""
        self._rows: dict[tuple[int, int], dict[int, _Received]] = {}  # by epoch and step

    @property
    def states_until(self) -> float:
        """When the last state was received, in s; -inf without states."""
        return max(self.heard.values(), default=-math.inf)

    @property
    def until(self) -> float:
        """When the last state or grant was received, in s; -inf without both."""
        return max(self.states_until, self.granted.at if self.granted else -math.inf)

    def add_grant(self, grant: Grant, now: float) -> None:
        """Take a grant. Raises ValueError if its terms are no text of terms."""
        before, unreadable = self.granted, ""
        if before is not None and before.grant.terms == grant.terms:
            configuration, factor = before.configuration, before.real_time_factor
            unreadable = before.unreadable
        else:
            try:
                configuration, factor = read_handshake(grant.terms)
            except FlockError as error:
                configuration, factor, unreadable = None, 0.0, str(error)
        self.granted = Granted(grant, now, configuration, factor, unreadable)

    def add_state(self, bird: int, state: State, now: float, sent: float) -> None:
        """Take a state of `bird` that was sent at time `sent`, in s."""
        self.heard[bird], self.sent[bird] = now, sent
        self._rows.setdefault((state.epoch, state.step), {})[bird] = _Received(state, now, sent)
        while len(self._rows) > MOST_ROWS:
            del self._rows[next(iter(self._rows))]

    def forget_states_before(self, since: float) -> None:
        """Drop the states that were received before time `since`, in s."""
        self.heard = {bird: at for bird, at in self.heard.items() if at >= since}
        for key, row in list(self._rows.items()):
            kept = {bird: received for bird, received in row.items() if received.at >= since}
            if kept:
                self._rows[key] = kept
            else:
                del self._rows[key]

    def rows(self, birds: int, members: int | None) -> list[Row]:
        """Return the whole rows, which have states of birds 1 to `birds`, as they were received.

        After a rewind, the step of the last one is not the highest. The rows before the last one
        are dropped, so the next call returns it first. All states have as many members: `members`,
        if not None.
        """
        whole = {key: row for key, row in self._rows.items() if _is_whole(row, birds, members)}
        if whole:
            last = next(reversed(whole))
            for key in list(self._rows):
                if key == last:
                    break
                del self._rows[key]
        return [
            Row([row[bird].state for bird in range(1, birds + 1)], row[1].sent)
            for row in whole.values()
        ]


def _is_whole(row: dict[int, _Received], birds: int, members: int | None) -> bool:
    """Tell whether `row` has states of birds 1 to `birds`, with the same number of members."""
    if birds < 1 or any(bird not in row for bird in range(1, birds + 1)):
        return False
    lengths = {len(row[bird].state.position) for bird in range(1, birds + 1)}
    return len(lengths) == 1 and members in (None, *lengths)
