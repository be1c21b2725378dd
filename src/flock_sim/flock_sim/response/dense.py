# SPDX-License-Identifier: Apache-2.0
"""The linear response of a flock with any coupling, by dense matrices.

At s = i omega, positions are x = v_1 / s + behind g, with the speed v_1 of bird 1 and the gaps g,
so nothing has a pole at s = 0 (`DelayedLinearisation.reduced`). With M(s) (v_1, g) = f, the
response is Z = M^-1, and its derivative by s is -Z M' Z. If the leader's speed is prescribed, it is
an acceleration of the leader that keeps it. So the others, the led birds, move as in the response
to the leader's acceleration, whose speeds v give v_i / v_leader and det Delta_led = v_leader det M.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from flock_sim.physics import formation
from flock_sim.physics.arrays import FloatArray
from flock_sim.response.elimination import ComplexArray, fill_moved
from flock_sim.theory.delayed.linearisation import DelayedLinearisation

MOST_CHANGE, MOST_TURN = 0.4, 1.2
"""Largest change of the logarithms of speeds and of determinants between two frequencies.

A determinant turns by pi at each resonance; 1.2 of it are passed within 0.7 of the half width.
"""

BLOCK = 2**20
"""Largest number of entries of a matrix for all frequencies that are computed at once."""


@dataclass(frozen=True)
class _Matrices:
    """The equations at some frequencies; the first axis is that of the frequencies."""

    where: slice
    root: ComplexArray
    """s, shape (frequencies, 1, 1)."""
    delta: ComplexArray
    """Delta(s), shape (frequencies, birds, birds)."""
    delta_slope: ComplexArray
    common: ComplexArray
    """Delta (1, ..., 1) / s, shape (frequencies, birds, 1)."""
    common_slope: ComplexArray
    behind: FloatArray

    @cached_property
    def reduced(self) -> ComplexArray:
        """M."""
        return np.concatenate([self.common, self.delta @ self.behind], axis=2)

    @cached_property
    def reduced_slope(self) -> ComplexArray:
        """M'."""
        return np.concatenate([self.common_slope, self.delta_slope @ self.behind], axis=2)

    @cached_property
    def answer(self) -> ComplexArray:
        """Z: rows for v_1 and the gaps."""
        return np.asarray(np.linalg.inv(self.reduced))

    def speed_logarithms(
        self, answer: ComplexArray, slope: ComplexArray
    ) -> tuple[ComplexArray, ComplexArray]:
        """Return the logarithms of the speeds of all birds, (frequencies, birds), and slopes.

        `answer` and its `slope` are v_1 and the gaps, shape (frequencies, birds, 1).
        """
        moved = self.behind @ answer[:, 1:]
        speed = answer[:, :1] + self.root * moved
        speed_slope = slope[:, :1] + moved + self.root * (self.behind @ slope[:, 1:])
        return np.log(speed[:, :, 0]), (speed_slope / speed)[:, :, 0]

    def gap_slopes(self, force: ComplexArray | FloatArray) -> ComplexArray:
        """Return the derivative by s of the gaps' response to `force` (frequencies, birds, 1)."""
        return np.asarray(-(self.answer @ (self.reduced_slope @ (self.answer @ force)))[:, 1:, 0])


class Dense:
    """The responses of one flock in which any bird may see any other: O(birds^3) a frequency.

    It has the methods of `Chain`. The flock has two birds or more.
    """

    def __init__(self, motion: DelayedLinearisation) -> None:
        """Take the equations `motion`."""
        self.motion = motion
        self.birds = len(motion.damping)
        self.scale = motion.most_rapid
        """An upper bound on |s| of roots that do not decay, in U_min / b."""
        self.free = [0]
        """The column of `logarithms` with the determinant of the flock."""
        self.held = [1]
        """The column of `logarithms` with the determinant of the led birds."""
        self.most_change = np.append([MOST_TURN] * 2, [MOST_CHANGE] * (self.birds - 1))
        """Largest change of each column of `logarithms` between two frequencies."""
        self._leader = formation.leader(self.birds) - 1
        self._led = np.flatnonzero(np.arange(self.birds) != self._leader)

    def logarithms(self, omega: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        """Return logarithms, shape (frequencies, 1 + birds), and their derivatives by s = i omega.

        They are those of the determinants of the flock and of the led birds, and of the speeds of
        these birds over that of the leader. Determinants are divided by powers of s + `scale`.
        """
        values, slopes = (np.empty((len(omega), 1 + self.birds), dtype=complex) for _ in range(2))
        degree = 2 * self.birds - 1
        for part in self._parts(omega):
            shifted = part.root[:, 0, 0] + self.scale
            sign, size = np.linalg.slogdet(part.reduced)
            values[part.where, 0] = size + np.log(sign) - degree * np.log(shifted)
            turned = (part.answer * part.reduced_slope.swapaxes(1, 2)).sum(axis=(1, 2))
            slopes[part.where, 0] = turned - degree / shifted
            answer = part.answer[:, :, [self._leader]]
            answer_slope = -(part.answer @ (part.reduced_slope @ answer))
            logarithm, slope = part.speed_logarithms(answer, answer_slope)
            own, own_slope = logarithm[:, self._leader], slope[:, self._leader]
            # the leader's own response times s is the quotient of both determinants
            values[part.where, 1] = values[part.where, 0] + own + np.log(shifted)
            slopes[part.where, 1] = slopes[part.where, 0] + own_slope + 1.0 / shifted
            values[part.where, 2:] = logarithm[:, self._led] - own[:, np.newaxis]
            slopes[part.where, 2:] = slope[:, self._led] - own_slope[:, np.newaxis]
        return values, slopes

    def followings(self, omega: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return log |u_i / u_leader|, (frequencies, birds), and its derivatives by omega."""
        gains, slopes = (np.empty((len(omega), self.birds)) for _ in range(2))
        force = np.zeros((self.birds, 1))
        force[self._leader] = 1.0
        for part in self._parts(omega):
            answer = _solved(part.reduced, force)
            answer_slope = -_solved(part.reduced, part.reduced_slope @ answer)
            logarithm, slope = part.speed_logarithms(answer, answer_slope)
            gains[part.where] = (logarithm - logarithm[:, [self._leader]]).real
            slopes[part.where] = -(slope - slope[:, [self._leader]]).imag
        return gains, slopes

    def from_leader(self, omega: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the log of the norm of all gaps per acceleration of the leader, and its slope."""
        gains, slopes = np.empty(len(omega)), np.empty(len(omega))
        force = np.zeros((self.birds, 1))
        force[self._leader] = 1.0
        for part in self._parts(omega):
            gap = part.answer[:, 1:, self._leader]
            square = (np.abs(gap) ** 2).sum(axis=1)
            gains[part.where] = 0.5 * np.log(square)
            turned = (np.conj(gap) * part.gap_slopes(force)).sum(axis=1)
            slopes[part.where] = -turned.imag / square
        return gains, slopes

    def largest_gains(self, omega: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the log of the largest singular value from accelerations to gaps, and slope."""
        gains, slopes = np.empty(len(omega)), np.empty(len(omega))
        for part in self._parts(omega):
            left, values, right = np.linalg.svd(part.answer[:, 1:], full_matrices=False)
            force = np.conj(right[:, 0, :, np.newaxis])
            gains[part.where] = np.log(values[:, 0])
            turned = (np.conj(left[:, :, 0]) * part.gap_slopes(force)).sum(axis=1)
            slopes[part.where] = -turned.imag / values[:, 0]
        return gains, slopes

    def densities(self, omega: FloatArray) -> FloatArray:
        """Return the squared responses summed over accelerations of single birds.

        Shape (frequencies, 2 birds): of the gaps, of the speeds, and of the mean speed.
        """
        response = self.responses(omega)
        squares = (np.abs(response) ** 2).sum(axis=2)
        mean = response[:, : self.birds].mean(axis=1)
        of_mean = (np.abs(mean) ** 2).sum(axis=1)
        return np.column_stack([squares[:, self.birds :], squares[:, : self.birds], of_mean])

    def responses(self, omega: FloatArray) -> ComplexArray:
        """Return the speeds and gaps per acceleration, (frequencies, 2 birds - 1, birds)."""
        responses = np.empty((len(omega), 2 * self.birds - 1, self.birds), dtype=complex)
        for part in self._parts(omega):
            gap = part.answer[:, 1:]
            responses[part.where, : self.birds] = part.answer[:, :1] + part.root * (
                part.behind @ gap
            )
            responses[part.where, self.birds :] = gap
        return responses

    def _parts(self, omega: FloatArray) -> Iterator[_Matrices]:
        """Yield the equations at all frequencies, in parts."""
        rows = max(1, BLOCK // self.birds**2)
        for first in range(0, len(omega), rows):
            part = omega[first : first + rows]
            roots = np.asarray(1j * part, dtype=np.complex128)
            yield self._matrices(slice(first, first + len(part)), roots)

    def _matrices(self, where: slice, roots: ComplexArray) -> _Matrices:
        motion, lag = self.motion, self.motion.lag
        moved, moved_slope = np.empty_like(roots), np.empty_like(roots)
        fill_moved(roots, lag, moved, moved_slope)
        moved, moved_slope = moved[:, np.newaxis], moved_slope[:, np.newaxis]
        single, root = roots[:, np.newaxis], roots[:, np.newaxis, np.newaxis]
        past = np.exp(-root * lag)
        response = motion.pull + root * (motion.push + root * motion.surge)
        response_slope = motion.push + 2.0 * root * motion.surge
        seen, seen_slope = past * response, past * (response_slope - lag * response)
        all_pull, all_surge = motion.pull.sum(axis=1), motion.surge.sum(axis=1)
        answer = motion.push.sum(axis=1) + single * all_surge
        own = np.eye(self.birds) * (single * (single + motion.damping) + all_pull)[:, np.newaxis]
        own_slope = np.eye(self.birds) * (2.0 * single + motion.damping)[:, np.newaxis]
        common = single + motion.damping - past[:, 0] * answer + all_pull * moved
        common_slope = 1.0 + past[:, 0] * (lag * answer - all_surge) + all_pull * moved_slope
        return _Matrices(
            where=where,
            root=root,
            delta=own - seen,
            delta_slope=own_slope - seen_slope,
            common=common[:, :, np.newaxis],
            common_slope=common_slope[:, :, np.newaxis],
            behind=formation.positions_by_gaps(self.birds),
        )


def _solved(matrix: ComplexArray, force: FloatArray | ComplexArray) -> ComplexArray:
    return np.asarray(np.linalg.solve(matrix, force), dtype=np.complex128)
