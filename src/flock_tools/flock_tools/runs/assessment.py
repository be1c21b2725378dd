# SPDX-License-Identifier: Apache-2.0
"""The assessment of a steady state: its existence, its spacings and its stability."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from flock_sim.analysis.metrics import plain
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.physics.flock import Flock
from flock_sim.theory.breakup import opening_gap, parts
from flock_sim.theory.equilibrium import Equilibrium, equilibrium
from flock_sim.theory.linear_stability import ComplexArray, eigenvalues

MOST_WORK = 1e10
"""Largest (2 birds)^3 times members for which eigenvalues are computed: a minute or less."""


@dataclass(frozen=True)
class Assessment:
    """The assessment of the steady states of all members of a flock."""

    configuration: FlockConfiguration
    state: Equilibrium
    eigenvalues: ComplexArray | None
    """Shape (members, 2 birds - 1), from the largest real part down; nan without a formation.

    None for a flock above MOST_WORK.
    """
    parts: list[list[list[int]]]
    """For each member: the groups of birds that stay together, the fastest group first."""
    weakest_gap: list[int]
    """For each member: the gap nearest to opening, or the gap that opens; 0 for none.

    It is also 0 where the worst set is not all birds on one side of a gap.
    """

    @classmethod
    def of(cls, configuration: FlockConfiguration) -> Assessment:
        """Return the assessment of the flock of a configuration."""
        flock = Flock.of(configuration)
        state = equilibrium(flock)
        groups = [parts(flock, state, m) for m in range(flock.members)]
        weakest = [
            int(gap) if state.exists[m] or not gap else opening_gap(state, groups[m], m)
            for m, gap in enumerate(state.worst_gap)
        ]
        found = None
        if 8.0 * flock.birds**3 * flock.members <= MOST_WORK:
            found = eigenvalues(flock, state.spacing, state.speed)
        return cls(configuration, state, found, groups, weakest)

    @property
    def stable(self) -> list[bool | None]:
        """Whether a formation exists and its small disturbances decay; None: not computed."""
        if self.eigenvalues is None:
            return [None if ok else False for ok in self.state.exists]
        return [bool(ok) for ok in self.eigenvalues[:, 0].real < 0.0]

    @property
    def leading_eigenvalue(self) -> list[complex]:
        """The eigenvalue of largest real part of each member, without the translation's; or nan."""
        if self.eigenvalues is None:
            return [complex(np.nan, np.nan)] * len(self.state.exists)
        return list(self.eigenvalues[:, 0].tolist())

    @property
    def worst_set(self) -> list[list[int]]:
        """For each member: the birds (from 1) that are the first to fall behind all others.

        It is empty for a bird alone, and if no speed balances thrust and drag.
        """
        return [(np.flatnonzero(birds) + 1).tolist() for birds in self.state.worst_set.T]

    def as_json(self) -> dict[str, Any]:
        """Return all results as plain values."""
        state, configuration = self.state, self.configuration
        facts = {
            "birds": configuration.birds,
            "members": configuration.members,
            "coupling": configuration.coupling,
            "exists": state.exists,
            "speed": state.speed,
            "spacing": state.spacing.T,
            "share": state.share.T,
            "margin": state.margin,
            "drag_reduction": state.drag_reduction.T,
            "stable": self.stable,
            "leading_eigenvalue": [[value.real, value.imag] for value in self.leading_eigenvalue],
            "weakest_gap": [gap or None for gap in self.weakest_gap],
            "worst_set": self.worst_set,
            "parts": self.parts,
            "lateral": state.lateral.T,
        }
        return {name: plain(value) for name, value in facts.items()}
