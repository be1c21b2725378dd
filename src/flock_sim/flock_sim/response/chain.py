# SPDX-License-Identifier: Apache-2.0
"""The linear response of a flock with nearest-neighbour coupling."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from flock_sim.physics import formation
from flock_sim.physics.arrays import FloatArray
from flock_sim.response import chain_kernels, elimination, largest_gain
from flock_sim.response.elimination import ComplexArray
from flock_sim.theory.delayed.linearisation import DelayedLinearisation

MOST_CHANGE = 0.4
"""Largest change of the logarithm of a factor of the determinant between two frequencies."""

SEED = 1
"""Seed of the first vector of the search for singular vectors, which must not be special."""


class Chain:
    """The responses of one flock whose birds see their neighbours only; O(birds) a frequency.

    Frequencies omega are in U_min / b, shape (frequencies,), as are all first axes of results.
    """

    def __init__(self, motion: DelayedLinearisation) -> None:
        """Take the constants of `motion`, whose birds see no other bird than neighbours."""
        self.motion = motion
        self.birds = len(motion.damping)
        self.scale = motion.most_rapid
        """An upper bound on |s| of roots that do not decay, in U_min / b."""
        self.most_change = np.full(self.birds, MOST_CHANGE)
        """Largest change of each column of `logarithms` between two frequencies."""
        self._leader = formation.leader(self.birds) - 1
        self.free = list(range(self.birds))
        """The columns of `logarithms` whose product is the determinant of the flock."""
        self.held = [j for j in self.free if j != self._leader]
        """The columns of `logarithms` whose product is the determinant of the led birds."""

    @cached_property
    def _constants(self) -> FloatArray:
        return _constants(self.motion, 1)

    @cached_property
    def _reverse(self) -> FloatArray:
        return _constants(self.motion, -1)

    def logarithms(self, omega: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        """Return the logarithms of factors of the determinants, (frequencies, birds), and slopes.

        Slopes are derivatives by s = i omega. All factors multiplied give the determinant of the
        flock; those of `held` columns give the determinant with the leader's speed prescribed.
        """
        values, slopes = (np.empty((len(omega), self.birds), dtype=complex) for _ in range(2))
        chain_kernels.fill_logarithms(
            *self._arguments(omega), self._leader, self.scale, values, slopes
        )
        return values, slopes

    def followings(self, omega: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return log |u_i / u_leader|, (frequencies, birds), and its derivatives by omega."""
        gains, slopes = (np.empty((len(omega), self.birds)) for _ in range(2))
        chain_kernels.fill_followings(*self._arguments(omega), self._leader, gains, slopes)
        return gains, slopes

    def from_leader(self, omega: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the log of the norm of all gaps per acceleration of the leader, and its slope."""
        gains, slopes = np.empty(len(omega)), np.empty(len(omega))
        chain_kernels.fill_from_leader(*self._arguments(omega), self._leader, gains, slopes)
        return gains, slopes

    def largest_gains(self, omega: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the log of the largest singular value from accelerations to gaps, and slope."""
        gains, slopes = np.empty(len(omega)), np.empty(len(omega))
        random = np.random.default_rng(SEED)
        start = random.standard_normal(self.birds - 1).astype(np.complex128)
        largest_gain.fill_largest_gains(*self._arguments(omega), start, gains, slopes)
        return gains, slopes

    def densities(self, omega: FloatArray) -> FloatArray:
        """Return the squared responses summed over accelerations of single birds.

        Shape (frequencies, 2 birds): of the gaps, of the speeds, and of the mean speed.
        """
        densities = np.empty((len(omega), 2 * self.birds))
        chain_kernels.fill_densities(*self._arguments(omega), densities)
        return densities

    def responses(self, omega: FloatArray) -> ComplexArray:
        """Return the speeds and gaps per acceleration, (frequencies, 2 birds - 1, birds)."""
        responses = np.zeros((len(omega), 2 * self.birds - 1, self.birds), dtype=complex)
        chain_kernels.fill_responses(*self._arguments(omega), responses)
        return responses

    def _arguments(self, omega: FloatArray) -> tuple[ComplexArray, float, FloatArray, FloatArray]:
        roots = np.asarray(1j * np.asarray(omega), dtype=np.complex128)
        return roots, self.motion.lag, self._constants, self._reverse


def _constants(motion: DelayedLinearisation, step: int) -> FloatArray:
    """Return the constants of `elimination` in order (`step` 1) or in reverse order (-1)."""
    birds = len(motion.damping)
    constants = np.zeros((elimination.CONSTANTS, birds))
    constants[elimination.DAMPING] = motion.damping[::step]
    constants[elimination.ALL_PULL] = motion.pull.sum(axis=1)[::step]
    for row, matrix in enumerate((motion.pull, motion.push, motion.surge)):
        ordered = matrix[::step, ::step]
        constants[elimination.PULL_BEFORE + row, 1:] = np.diag(ordered, -1)
        constants[elimination.PULL_AFTER + row, :-1] = np.diag(ordered, 1)
    return constants
