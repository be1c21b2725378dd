# SPDX-License-Identifier: Apache-2.0
"""Assembles the received messages of a flock to one snapshot."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from flock_sim.analysis.metrics import plain, speed_std
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.errors import FlockError
from flock_sim.messages.state import MEANS, VALUES
from flock_sim.messages.types import Grant, State, Wing
from flock_sim.physics import formation
from flock_sim.physics.arrays import FloatArray
from flock_sim.physics.flock_state import FlockState
from flock_sim.physics.scaling import Scales
from flock_tools.live.players import Players, Publisher
from flock_tools.live.received_run import Granted, ReceivedRun
from flock_tools.live.step_rate import StepRate

SILENT = 2.0
"""Time without a state or a grant of the observed run after which another run replaces it, in s."""

MOST_RUNS = 8
"""Largest number of runs whose messages are kept."""

WIDEST = 1000.0
"""Span ratio from which a received wing is ignored."""


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
    speed_std: float
    """sigma_U, in U_min."""
    interaction_drag: list[float]
    drag_reduction: list[float] | None
    age: list[float]
    """Time since the last message of each bird was sent, in s."""
    hears: list[list[int]] | None

    def as_json(self) -> dict[str, object]:
        """Return plain lists and numbers, with None for non-finite values."""
        return {name: plain(value) for name, value in vars(self).items()}


class View:
    """Takes the messages of a flock, and gives the latest step with states of all birds.

    Several flocks may use the same topics. The messages of each run are kept apart, and one run is
    observed: the first one, until it is silent and another one is not.
    """

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        """Begin without messages. `now` returns the time in s."""
        self._now = now
        self._players = Players()
        self._runs: dict[int, ReceivedRun] = {}
        self._run: int | None = None
        self._shown: list[State] = []
        self._sent = -math.inf
        self._rate = StepRate()

    def hear_grant(self, data: bytes) -> None:
        """Take a grant of a clock, which has the configuration. Invalid grants are ignored.

        A grant whose configuration this version of Flock can't read is not: see `unreadable`.
        """
        with suppress(ValueError, TypeError, AttributeError):
            grant = Grant.decode(data)
            self._received(grant.run_id).add_grant(grant, self._now())

    def hear_wing(self, bird: int, data: bytes) -> None:
        """Take the wing of `bird`. Invalid wings are ignored."""
        with suppress(ValueError):
            wing = Wing.decode(data)
            if np.all((wing.span_ratio > 0.0) & (wing.span_ratio < WIDEST)):
                self._received(wing.run_id).wings[bird] = wing, self._now()

    def hear_state(self, bird: int, data: bytes, age: float = 0.0) -> None:
        """Take a state of `bird` that was sent `age` s ago. Ignore invalid states."""
        now = self._now()  # first, since `age` counts up to now
        try:
            state = State.decode(data)
        except ValueError:
            return
        if _members(state) is None:
            return
        self._received(state.run_id).add_state(bird, state, now, now - age)
        if self._run is None:
            self._run = state.run_id

    def see_publishers(
        self, states: Mapping[int, Collection[Publisher]], grants: Collection[Publisher]
    ) -> None:
        """Take the publishers of each bird's states and of grants, as they are now.

        A recorded flight of a player that was not there before is a new flock.
        """
        before = self._players.since
        self._players.look(states, grants, self._now())
        if self._players.since != before and 0 in self._runs:
            self._runs[0].forget_states_before(self._players.since)
            if self._run == 0:
                self._start_anew()

    def sample(self, known: Collection[int], member: int) -> Sample | None:
        """Return the latest complete step of the flock; None while a bird is missing.

        `known` are the birds whose topics were found. They are the flock if no grant gives its
        number of birds. Raises FlockError if the flock has no such member.
        """
        row = self.row(known, member)
        return self._sampled(row, member, self.granted) if row else None

    def row(self, known: Collection[int], member: int) -> list[State]:
        """Return the states of the latest step that is complete; empty if there is none.

        Raises FlockError if the states have no such member.
        """
        self._choose()
        if self._run is None:
            return []
        flown = self.flown
        known = self._players.birds or known if self._run == 0 else known
        birds = flown.birds if flown else max(known, default=0)
        members = flown.members if flown else None
        for states, sent in self._runs[self._run].rows(birds, members):
            self._shown, self._sent = states, sent
            self._rate.see(states[0].step, sent, self._now())
        row = self._shown
        if len(row) != birds or (row and members not in (None, len(row[0].position))):
            return []
        if row and member > len(row[0].position):
            raise FlockError(
                f"--member {member}: must be in 1..{len(row[0].position)}, the members of the flock"
            )
        return row

    def span_ratio(self, row: Sequence[State]) -> FloatArray | None:
        """Return the span ratios of a row's birds from their wings, shape (birds, members).

        None while one is missing.
        """
        wings = [self._wing(bird) for bird in range(1, len(row) + 1)]
        ratios = [
            wing.span_ratio
            for wing, state in zip(wings, row, strict=True)
            if wing is not None and len(wing.span_ratio) == len(state.position)
        ]
        return np.array(ratios) if row and len(ratios) == len(row) else None

    @property
    def behind(self) -> float:
        """Time since the latest complete step was sent, in s; inf without one."""
        return self._now() - self._sent

    @property
    def granted(self) -> Granted | None:
        """The last grant of the observed run; None if there is none.

        A played flight has the grants of the run that was recorded, if its player publishes grants.
        """
        if self._run:
            return self._runs[self._run].granted
        found = [run.granted for run in self._of_played() if run.granted]
        found = [each for each in found if self._players.grant and each.at >= self._players.since]
        return max(found, key=lambda granted: granted.at, default=None)

    @property
    def played(self) -> bool:
        """Whether the observed flight is a recorded one."""
        return self._run == 0

    @property
    def source(self) -> tuple[int | None, float]:
        """What distinguishes the observed flight: its run, and of a recorded one its player."""
        return self._run, self._players.since if self.played else 0.0

    @property
    def awaits_grant(self) -> bool:
        """Whether no grant is received of the observed flight, but its publisher is known."""
        players = self._players
        return self.granted is None and (players.grant if self.played else players.clock)

    @property
    def flown(self) -> FlockConfiguration | None:
        """The configuration of the observed run, if a grant gives it."""
        granted = self.granted
        return granted.configuration if granted else None

    @property
    def unreadable(self) -> str:
        """Why the configuration in the last grant can't be read; empty if it can be."""
        granted = self.granted
        return granted.unreadable if granted else ""

    def _wing(self, bird: int) -> Wing | None:
        """Return the wing of a bird of the observed run."""
        runs = [self._runs[self._run]] if self._run else self._of_played()
        since = -math.inf if self._run else self._players.since
        found = [run.wings[bird] for run in runs if bird in run.wings]
        return next((wing for wing, at in found if at >= since), None)

    def _of_played(self) -> list[ReceivedRun]:
        """Return the runs that a played flight may have been recorded from, the last one first.

        Recorded states have run id 0, for any run id of their grants and wings. A run whose states
        are received themselves is flown now, and not played.
        """
        since = self._players.since
        return [
            run
            for number, run in reversed(self._runs.items())
            if not number or not run.heard or run.states_until < since
        ]

    @np.errstate(over="ignore", invalid="ignore")  # of a bird that diverges
    def _sampled(self, row: list[State], member: int, granted: Granted | None) -> Sample:
        birds = len(row)
        members = len(row[0].position)
        state = FlockState.of(row).member(member - 1)
        flown = granted.configuration if granted else None
        sent = self._runs[self._run or 0].sent
        now = self._now()
        return Sample(
            birds=birds,
            members=members,
            member=member,
            leader=formation.leader(birds),
            step=state.step,
            time=state.time,
            end=granted.grant.end if flown and granted else None,
            coupling=flown.coupling if flown else None,
            real_time_factor=granted.real_time_factor if flown and granted else None,
            rate=self._rate.at(now),
            position=state.from_leader.tolist(),
            speed=state.speed.tolist(),
            speed_std=float(speed_std(state.speed)),
            interaction_drag=state.interaction_drag.tolist(),
            drag_reduction=state.drag_reduction(Scales.of(flown)).tolist() if flown else None,
            age=[max(0.0, now - sent[bird]) for bird in range(1, birds + 1)],
            hears=[
                list(formation.neighbours(bird, birds, flown.coupling))
                for bird in range(1, birds + 1)
            ]
            if flown
            else None,
        )

    def _choose(self) -> None:
        """Observe the run whose state came last, once the observed one is silent.

        Grants of a recorded flight are no sign that it is still flown.
        """
        if self._run is None:
            return
        observed = self._runs[self._run]
        until = observed.until if self._players.clock else observed.states_until
        if self._now() - until < SILENT:
            return
        latest = max(self._runs, key=lambda number: self._runs[number].states_until)
        if self._runs[latest].states_until > until:
            self._run = latest
            self._start_anew()

    def _start_anew(self) -> None:
        """Show nothing of the flock before."""
        self._shown, self._sent = [], -math.inf
        self._rate.clear()

    def _received(self, number: int) -> ReceivedRun:
        """Return the messages of a run, as the last one of all runs."""
        run = self._runs.pop(number, None) or ReceivedRun()
        while len(self._runs) >= MOST_RUNS:
            del self._runs[next(each for each in self._runs if each != self._run)]
        self._runs[number] = run
        return run


def _members(state: State) -> int | None:
    """Return the number of members of a state; None if its arrays disagree, as no bird's do."""
    lengths = {len(getattr(state, name)) for name in VALUES}
    lengths |= {len(getattr(state, name)) for name in MEANS} - {0}  # none in earlier versions
    return max(lengths) or None if len(lengths) == 1 else None
