# SPDX-License-Identifier: Apache-2.0
"""The wings of a bird's neighbours, and the geometry computed from them."""

from __future__ import annotations

from collections import Counter

import numpy as np

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.messages.epochs import NEVER
from flock_sim.messages.rejection import FOREIGN, IMPOSSIBLE, STRANGE
from flock_sim.messages.topics import bird_name
from flock_sim.messages.types import Grant, Progress, Wing
from flock_sim.physics import formation
from flock_sim.physics.arrays import FloatArray
from flock_sim.physics.stage_kernels import LATERAL, fill_interactions, interaction_array
from flock_sim.protocol.session import Channel, Outgoing, Session

EARLY = 16
"""Most wings kept per neighbour while the own run is unknown."""


class Neighbourhood:
    """The neighbours of one bird. `birds` are their numbers, in ascending order.

    `interactions` is the interaction array of this bird and each of them, which is filled once
    every wing is known.
    """

    def __init__(self, bird: int, configuration: FlockConfiguration) -> None:
        """Start with the wing of `bird` alone."""
        self.birds = formation.neighbours(bird, configuration.birds, configuration.coupling)
        self.interactions = interaction_array(len(self.birds), configuration.members)
        self._bird = bird
        self._members = configuration.members
        self._wings = {bird: configuration.span_ratio[bird - 1]}
        self._early: dict[tuple[int, int], Wing] = {}

    @property
    def known(self) -> bool:
        """Whether every wing is known."""
        return len(self._wings) > len(self.birds)

    @property
    def unknown(self) -> list[int]:
        """The neighbours whose wings are not known."""
        return [other for other in self.birds if other not in self._wings]

    @property
    def lateral(self) -> FloatArray:
        """y of each neighbour minus that of the bird, in b, shape (members, neighbours).

        Only once every wing is known.
        """
        distance = self.interactions[LATERAL, : len(self.birds) * self._members]
        left = np.where(np.array(self.birds) < self._bird, -1.0, 1.0)
        return np.asarray(distance.reshape(len(self.birds), self._members).T * left)

    def hear(self, wing: Wing, run_id: int) -> str:
        """Store a neighbour's wing; return why it is ignored, or "". `run_id` 0: not known yet.

        Wings that arrive before the run is known are kept for `recall`.
        """
        ratio = wing.span_ratio
        if wing.bird not in self.birds:
            return STRANGE
        if len(ratio) != self._members or not np.all(np.isfinite(ratio) & (ratio > 0.0)):
            return IMPOSSIBLE
        if run_id == 0:
            self._early[wing.run_id, wing.bird] = wing
            if len(self._early) <= EARLY * len(self.birds):
                return ""
            del self._early[next(iter(self._early))]  # the oldest, which is now ignored
            return FOREIGN
        if wing.run_id != run_id:
            return FOREIGN
        if wing.bird not in self._wings:
            self._wings[wing.bird] = ratio
            if self.known:
                self._learn_geometry()
        return ""

    def recall(self, run_id: int) -> None:
        """Store the wings that arrived before the run was known."""
        early, self._early = self._early, {}
        for wing in early.values():
            self.hear(wing, run_id)

    def _learn_geometry(self) -> None:
        for k, other in enumerate(self.birds):
            low, high = sorted((self._bird, other))
            row = np.stack([self._wings[between] for between in range(low, high + 1)])
            fill_interactions(
                self.interactions,
                k * self._members,
                formation.lateral_distance(row),
                formation.VORTEX_FRACTION * self._wings[self._bird],
                formation.VORTEX_FRACTION * self._wings[other],
            )


class Listener:
    """A bird among its neighbours."""

    _around: Neighbourhood
    _session: Session
    bird: int
    """Its number, from 1."""
    ignored: int
    """Number of ignored messages."""
    ignored_for: Counter[str]
    """Number of ignored messages, by reason."""

    @property
    def run_id(self) -> int:
        """The run of this bird; 0 if it is not known yet."""
        return self._session.run_id

    @property
    def step(self) -> int:
        """The current step."""
        raise NotImplementedError

    @property
    def released(self) -> bool:
        """Whether the clock has ended the run and no node needs this bird any more."""
        return self._session.released(self.step)

    @property
    def neighbours(self) -> tuple[int, ...]:
        """The birds whose messages this bird receives."""
        return self._around.birds

    def ignore(self, reason: str) -> list[Outgoing]:
        """Count an ignored message."""
        self.ignored += 1
        self.ignored_for[reason] += 1
        return []

    def receive_grant(self, grant: Grant) -> list[Outgoing]:
        """Begin the grant's epoch, or continue the present one as far as the grant allows.

        Raises FlockError if the first grant is of another flight, and RunFailed if a new epoch
        begins while a free flight is in progress.
        """
        session = self._session
        if reason := session.refuses_grant(grant):
            return self.ignore(reason)
        first = session.epoch == NEVER
        return self._join(grant, first) if session.take_grant(grant) else self._extend(grant)

    def _join(self, grant: Grant, first: bool) -> list[Outgoing]:
        """Begin the grant's epoch; `first`: no epoch was known before."""
        raise NotImplementedError

    def _extend(self, grant: Grant) -> list[Outgoing]:
        """Continue the present epoch as far as the grant allows."""
        raise NotImplementedError

    def _progress(self, step: int) -> Outgoing:
        """Return the report of having reached `step`; -1: present, but not yet at the start."""
        session = self._session
        who, incarnation = bird_name(self.bird), session.incarnation
        progress = Progress(session.run_id, step, session.epoch, who, incarnation)
        return Channel.PROGRESS, progress.encode()
