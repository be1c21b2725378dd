# SPDX-License-Identifier: Apache-2.0
"""Assembles the received messages of a flock to one snapshot."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass

from flock_sim.analysis.metrics import plain
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.errors import FlockError
from flock_sim.messages.handshake import read_handshake
from flock_sim.messages.types import ARRAYS, Grant, State
from flock_sim.physics import formation
from flock_sim.physics.flock_state import FlockState
from flock_sim.physics.scaling import Scales

SILENT = 2.0
"""Time without a message of the observed run after which another run replaces it, in s."""

MOST_ROWS = 256
"""Largest number of steps that are kept while some of their states are missing."""

RATE_OVER = 2.0
"""Time over which the rate is averaged, in s."""


@dataclass(frozen=True)
class Sample:
    """One member of a flock at one step; lists from bird 1 to N, dimensionless.

    `drag_reduction`, `hears`, `coupling`, `end` and `real_time_factor` are None until a grant is
    received.
    """

    birds: int
    members: int
    member: int
    leader: int
    step: int
    time: float
    """In b / U_min."""
    end: int | None
    """The last step of the flight."""
    coupling: str | None
    real_time_factor: float | None
    """That of a free flight; 0 for a flight in lockstep."""
    rate: float | None
    """Steps per second; None until two steps are received."""
    position: list[float]
    """Relative to the leader, in b."""
    speed: list[float]
    """In U_min."""
    interaction_drag: list[float]
    drag_reduction: list[float] | None
    age: list[float]
    """Time since the last message of each bird, in s."""
    hears: list[list[int]] | None

    def as_json(self) -> dict[str, object]:
        """Return plain lists and numbers, with None for non-finite values."""
        return {name: plain(value) for name, value in vars(self).items()}


class View:
    """Takes the messages of a flock, and gives the latest step with states of all birds."""

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        """Begin without messages. `now` returns the time in s."""
        self._now = now
        self._grant: Grant | None = None
        self._configuration: FlockConfiguration | None = None
        self._factor = 0.0
        self.unreadable = ""
        """Why the configuration in the last grant can't be read; empty if it can be."""
        self._shown: dict[int, State] = {}
        self._forget(0)

    def hear_grant(self, data: bytes) -> None:
        """Take a grant of a clock, which has the configuration. Invalid grants are ignored.

        A grant whose configuration this version of Flock can't read is not: see `unreadable`.
        """
        try:
            grant = Grant.decode(data)
            if self._grant is None or grant.terms != self._grant.terms:
                self._configuration, self._factor = read_handshake(grant.terms)
        except FlockError as error:
            self._configuration, self.unreadable = None, str(error)
        except (ValueError, TypeError, AttributeError):
            return
        else:
            self.unreadable = ""
        self._grant = grant

    def hear_state(self, bird: int, data: bytes) -> None:
        """Take a state of `bird`. Ignore invalid states, and other runs while one is observed."""
        try:
            state = State.decode(data)
        except ValueError:
            return
        if _members(state) is None:
            return
        now = self._now()
        if state.run_id != self._run:
            if self._heard and now - max(self._heard.values()) < SILENT:
                return
            self._forget(state.run_id)
        self._heard[bird] = now
        self._rows.setdefault(state.step, {})[bird] = state
        while len(self._rows) > MOST_ROWS:
            del self._rows[next(iter(self._rows))]

    def sample(self, known: Collection[int], member: int) -> Sample | None:
        """Return the latest complete step of the flock; None while a bird is missing.

        `known` are the birds whose topics were found. They are the flock if no grant gives its
        number of birds. Raises FlockError if the flock has no such member.
        """
        row = self.row(known, member)
        return self._sampled(row, member, self.flown) if row else None

    def row(self, known: Collection[int], member: int) -> list[State]:
        """Return the states of the latest step that is complete; empty if there is none.

        Raises FlockError if the states have no such member.
        """
        flown = self.flown
        birds = flown.birds if flown else max(known, default=0)
        whole = [step for step, row in self._rows.items() if self._of_all(row, birds)]
        if whole:
            # The row received last: after a rewind, its step is not the highest.
            self._shown = self._rows[whole[-1]]
            if self._steps and whole[-1] < self._steps[-1][1]:
                self._steps.clear()  # after a rewind or a new playback, the rate starts anew
            self._steps.append((self._now(), whole[-1]))
            for step in list(self._rows):
                if step == whole[-1]:
                    break
                del self._rows[step]
        row = self._of_all(self._shown, birds)
        if not row:
            return []
        members = len(row[0].position)
        if member > members:
            raise FlockError(
                f"--member {member}: must be in 1..{members}, the members of the flock"
            )
        return row

    def _of_all(self, row: Mapping[int, State], birds: int) -> list[State]:
        """Return the states of birds 1 to `birds`; empty unless all exist with equal members."""
        if birds < 1 or any(bird not in row for bird in range(1, birds + 1)):
            return []
        states = [row[bird] for bird in range(1, birds + 1)]
        flown = self.flown
        members = flown.members if flown else len(states[0].position)
        return states if all(len(state.position) == members for state in states) else []

    def _sampled(self, row: list[State], member: int, flown: FlockConfiguration | None) -> Sample:
        birds = len(row)
        members = len(row[0].position)
        state = FlockState.of(row).member(member - 1)
        now = self._now()
        return Sample(
            birds=birds,
            members=members,
            member=member,
            leader=formation.leader(birds),
            step=state.step,
            time=state.time,
            end=self._grant.end if flown and self._grant else None,
            coupling=flown.coupling if flown else None,
            real_time_factor=self._factor if flown else None,
            rate=self._rate(now),
            position=state.from_leader.tolist(),
            speed=state.speed.tolist(),
            interaction_drag=state.interaction_drag.tolist(),
            drag_reduction=state.drag_reduction(Scales.of(flown)).tolist() if flown else None,
            age=[now - self._heard[bird] for bird in range(1, birds + 1)],
            hears=[
                list(formation.neighbours(bird, birds, flown.coupling))
                for bird in range(1, birds + 1)
            ]
            if flown
            else None,
        )

    @property
    def flown(self) -> FlockConfiguration | None:
        """The configuration, if the grant is of the observed run or the states are of run 0."""
        ours = self._grant is not None and self._run in (0, self._grant.run_id)
        return self._configuration if ours else None

    def _rate(self, now: float) -> float | None:
        while len(self._steps) > 2 and now - self._steps[0][0] > RATE_OVER:
            self._steps.popleft()
        if len(self._steps) < 2:
            return None
        (begun, first), (ended, last) = self._steps[0], self._steps[-1]
        return (last - first) / (ended - begun) if ended > begun else None

    def _forget(self, run: int) -> None:
        self._run = run
        self._rows: dict[int, dict[int, State]] = {}
        self._shown = {}
        self._heard: dict[int, float] = {}
        self._steps: deque[tuple[float, int]] = deque()


def _members(state: State) -> int | None:
    """Return the number of members of a state; None if its arrays disagree, as no bird's do."""
    lengths = {len(getattr(state, name)) for name in ARRAYS}
    return max(lengths) or None if len(lengths) == 1 else None
