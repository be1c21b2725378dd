# SPDX-License-Identifier: Apache-2.0
"""What has been heard of a flock, put together to one picture of it."""

from __future__ import annotations

import json
import time
from collections import deque
from collections.abc import Callable, Collection
from dataclasses import dataclass

from flock_sim.core import formation
from flock_sim.core.configuration import FlockConfiguration
from flock_sim.core.messages import Grant, State
from flock_sim.core.metrics import plain
from flock_sim.core.scaling import Scales
from flock_sim.errors import FlockError

SILENT = 2.0
"""Time, in s, after which another run on the domain is watched in place of one that is silent."""

MOST_ROWS = 256
"""Steps of which some states have been heard and some not."""

RATE_OVER = 2.0
"""Time, in s, over which the rate is taken."""


@dataclass(frozen=True)
class Sample:
    """One member of a flock at one step; lists from bird 1 to N, dimensionless.

    `drag_reduction`, `hears`, `coupling` and `end` are None as long as no grant has told them.
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
    rate: float | None
    """Steps a second; None until two were heard."""
    position: list[float]
    """Relative to the leader, in b."""
    speed: list[float]
    """In U_min."""
    interaction_drag: list[float]
    drag_reduction: list[float] | None
    age: list[float]
    """Since the last message was heard, in s."""
    hears: list[list[int]] | None

    def as_json(self) -> dict[str, object]:
        """Return plain lists and numbers, None for what is not finite."""
        return {name: plain(value) for name, value in vars(self).items()}


class View:
    """Takes the messages of a flock, and gives the latest step of which every bird was heard."""

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        """Begin with nothing heard; `now` is in s."""
        self._now = now
        self._grant: Grant | None = None
        self._configuration: FlockConfiguration | None = None
        self._shown: dict[int, State] = {}
        self._forget(0)

    def hear_grant(self, data: bytes) -> None:
        """Take leave of a clock, which says what is flown; ignores what is none."""
        try:
            grant = Grant.decode(data)
            if self._grant is None or grant.terms != self._grant.terms:
                self._configuration = FlockConfiguration.from_parameters(json.loads(grant.terms))
        except (ValueError, TypeError, AttributeError, FlockError):
            return
        self._grant = grant

    def hear_state(self, bird: int, data: bytes) -> None:
        """Take a state of `bird`; ignores what is none, and other runs while one is heard."""
        try:
            state = State.decode(data)
        except ValueError:
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
        """Return the flock as it was last heard of; None as long as a bird is missing.

        `known` are the birds whose topics were found: the flock, where no grant says how many it
        has. Raises FlockError where it has no such member.
        """
        row = self.row(known, member)
        return self._sampled(row, member, self.flown) if row else None

    def row(self, known: Collection[int], member: int) -> list[State]:
        """Return the states of the last step that was heard of all birds; nothing without one.

        Raises FlockError where they have no such member.
        """
        flown = self.flown
        birds = flown.birds if flown else max(known, default=0)
        whole = [step for step, row in self._rows.items() if birds and len(row) == birds]
        if whole:
            # The row that was last begun to be heard: after a rewind, that is not the highest.
            self._shown = self._rows[whole[-1]]
            self._steps.append((self._now(), whole[-1]))
            for step in list(self._rows):
                if step == whole[-1]:
                    break
                del self._rows[step]
        if not len(self._shown) == birds > 0:
            return []
        row = [self._shown[bird] for bird in sorted(self._shown)]
        members = len(row[0].position)
        if member > members:
            raise FlockError(f"--member {member}: must be in 1..{members}, as the flock has them")
        return row

    def _sampled(self, row: list[State], member: int, flown: FlockConfiguration | None) -> Sample:
        birds = len(row)
        members = len(row[0].position)
        m = member - 1
        leader = formation.leader(birds)
        drag = [float(state.interaction_drag[m]) for state in row]
        now = self._now()
        return Sample(
            birds=birds,
            members=members,
            member=member,
            leader=leader,
            step=row[0].step,
            time=row[0].time,
            end=self._grant.end if flown and self._grant else None,
            coupling=flown.coupling if flown else None,
            rate=self._rate(now),
            position=[float(state.position[m] - row[leader - 1].position[m]) for state in row],
            speed=[float(state.speed[m]) for state in row],
            interaction_drag=drag,
            drag_reduction=[(0.0 - value) / Scales.of(flown).cruise_drag for value in drag]
            if flown
            else None,
            age=[now - self._heard[bird] for bird in sorted(self._shown)],
            hears=[
                list(formation.neighbours(bird, birds, flown.coupling))
                for bird in range(1, birds + 1)
            ]
            if flown
            else None,
        )

    @property
    def flown(self) -> FlockConfiguration | None:
        """What is flown, where the grant is of the run that is heard; recorded states name none."""
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
