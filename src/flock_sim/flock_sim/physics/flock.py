# SPDX-License-Identifier: Apache-2.0
"""A flock as one system: the constants of the equations of motion of all its birds.

It serves code that has the whole flock: the reference, ensembles, equilibria. A bird in flight
computes its own part from the messages of its neighbours.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from flock_sim.physics import formation
from flock_sim.physics.arrays import FloatArray
from flock_sim.physics.scaling import BirdCoefficients, Scales
from flock_sim.physics.stage_kernels import EVEN, fill_interactions, interaction_array

if TYPE_CHECKING:
    from flock_sim.configuration.flock_configuration import FlockConfiguration


@dataclass(frozen=True)
class Flock:
    """Birds and interacting pairs of a flock, or of an ensemble of as many flocks as `members`.

    The span ratios of neighbours must sum to more than 1, which the configuration checks.
    """

    coupling: str
    scales: Scales
    span_ratio: FloatArray
    """lambda_i, shape (birds, members)."""

    @classmethod
    def of(cls, configuration: FlockConfiguration, span_ratio: FloatArray | None = None) -> Flock:
        """Return the flock of a configuration, or one of the same kind with other span ratios."""
        ratio = configuration.span_ratio if span_ratio is None else span_ratio
        # Kernels are compiled for one layout of arrays.
        ratio = np.ascontiguousarray(ratio)
        return cls(configuration.coupling, Scales.of(configuration), ratio)

    def select(self, members: npt.NDArray[np.int64]) -> Flock:
        """Return the flocks with the indices `members`."""
        return replace(self, span_ratio=np.ascontiguousarray(self.span_ratio[:, members]))

    @property
    def birds(self) -> int:
        """Number N of birds."""
        return int(self.span_ratio.shape[0])

    @property
    def members(self) -> int:
        """Number M of flocks."""
        return int(self.span_ratio.shape[1])

    @cached_property
    def coefficients(self) -> FloatArray:
        """The rows of `BirdCoefficients`, shape (birds, 5, members)."""
        return np.stack([BirdCoefficients.of(self.scales, row).rows() for row in self.span_ratio])

    @property
    def elements(self) -> FloatArray:
        """The same in the order of `physics.stage_kernels`, shape (5, birds * members)."""
        return np.ascontiguousarray(self.coefficients.swapaxes(0, 1)).reshape(5, -1)

    @cached_property
    def half_span(self) -> FloatArray:
        """Vortex half-spans a_i, shape (birds, members), in b."""
        return formation.VORTEX_FRACTION * self.span_ratio

    @cached_property
    def pairs(self) -> npt.NDArray[np.int64]:
        """Indices (from 0) of the interacting birds, ascending, shape (pairs, 2)."""
        pairs = list(formation.pairs(self.birds, self.coupling))
        return np.array(pairs, dtype=np.int64).reshape(-1, 2) - 1

    @cached_property
    def lateral(self) -> FloatArray:
        """Lateral distance of each pair, shape (pairs, members), in b."""
        lateral = np.empty((len(self.pairs), self.members))
        for k, (tail, head) in enumerate(self.pairs):
            lateral[k] = formation.lateral_distance(self.span_ratio[tail : head + 1])
        return lateral

    @cached_property
    def even(self) -> FloatArray:
        """E of each pair, shape (pairs, members)."""
        even: FloatArray = self.interactions(self.pairs)[EVEN, : self.lateral.size]
        return even.reshape(self.lateral.shape)

    def interactions(self, pairs: npt.NDArray[np.int64]) -> FloatArray:
        """Return the interaction array of `pairs`, indices of a bird and another one, (pairs, 2).

        Each must be one of `self.pairs`, in either order.
        """
        index = {(i, j): k for k, (i, j) in enumerate(self.pairs.tolist())}
        array = interaction_array(len(pairs), self.members)
        for k, (i, j) in enumerate(pairs.tolist()):
            fill_interactions(
                array,
                k * self.members,
                self.lateral[index[min(i, j), max(i, j)]],
                self.half_span[i],
                self.half_span[j],
            )
        return array
