# SPDX-License-Identifier: Apache-2.0
"""Frequencies close enough together to resolve every resonance, and the number of unstable roots.

The responses of a flock are quotients of determinants, whose zeros are resonances: a zero at
-delta + i omega_0 changes the logarithm of the determinant by about i pi while omega passes
omega_0, within a width of about delta. So an interval is halved until the logarithm of no factor
changes by more than `most_change`, by its values at the ends as well as by its slopes there.

The argument principle counts the roots with a real part above 0, and shows that no resonance was
overlooked. The determinant divided by (s + w)^degree, w > 0, tends to 1, so its argument at
omega = 0 minus that at infinity is pi times the number of these roots. A stable resonance that lies
unseen between two frequencies would add two to the count.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from flock_sim.errors import RunFailed
from flock_sim.physics.arrays import FloatArray
from flock_sim.response.elimination import ComplexArray

TOP = 30.0
"""The highest frequency over the largest |s| of a root that does not decay."""

LEAST = 1e-13
"""Frequency over the highest one below which nothing is resolved: for geese periods of 10^4 years.

Late birds hardly see the birds behind them. If the leader flies far back, it holds those ahead by
springs that are weaker from bird to bird, so that they follow a prescribed speed only after such
times. No factor has more than one root there, so that the count of roots remains right.
"""

OCTAVES, PER_OCTAVE = 24, 4
"""Range and density of the frequencies from which the refinement starts."""

MOST_FREQUENCIES = 200_000
MOST_ROUNDS = 40


class Responses(Protocol):
    """The responses of a flock at frequencies omega; see `Chain`."""

    birds: int
    scale: float
    most_change: FloatArray
    free: list[int]
    held: list[int]

    def logarithms(self, omega: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        """Return logarithms whose changes show resonances, and their derivatives by s."""

    def followings(self, omega: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return log |u_i / u_leader|, (frequencies, birds), and its derivatives by omega."""

    def from_leader(self, omega: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the log of the norm of all gaps per acceleration of the leader, and its slope."""

    def largest_gains(self, omega: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the log of the largest singular value from accelerations to gaps, and slope."""

    def densities(self, omega: FloatArray) -> FloatArray:
        """Return squared responses summed over single birds: gaps, speeds, mean speed."""

    def responses(self, omega: FloatArray) -> ComplexArray:
        """Return the speeds and gaps per acceleration, (frequencies, 2 birds - 1, birds)."""


@dataclass(frozen=True)
class Frequencies:
    """Ascending frequencies from 0 that resolve all resonances, and the counts of roots."""

    omega: FloatArray
    """In U_min / b."""
    unstable: int
    """Number of roots of the flock with a real part above 0, without the root 0 of translation."""
    unstable_led: int
    """The same with the leader's speed prescribed."""

    @classmethod
    def of(cls, flock: Responses) -> Frequencies:
        """Return the frequencies for a flock. Raises RunFailed if there are too many."""
        top = TOP * flock.scale
        steps = np.arange(OCTAVES * PER_OCTAVE, -1, -1)
        omega = np.concatenate([[0.0], top * 2.0 ** (-steps / PER_OCTAVE)])
        values, slopes = flock.logarithms(omega)
        for _ in range(MOST_ROUNDS):
            changes = _changes(omega, values, slopes, flock.most_change)
            wide = np.flatnonzero((changes > 1.0) & (omega[1:] > LEAST * top))
            if not len(wide):
                break
            if len(omega) + len(wide) > MOST_FREQUENCIES:
                break
            between = 0.5 * (omega[wide] + omega[wide + 1])
            more, their_slopes = flock.logarithms(between)
            omega = np.insert(omega, wide + 1, between)
            values = np.insert(values, wide + 1, more, axis=0)
            slopes = np.insert(slopes, wide + 1, their_slopes, axis=0)
        if len(wide):
            raise RunFailed(
                f"the response has resonances narrower than {np.diff(omega).min():.2g} U_min/b, "
                "which cannot be resolved: the flock hardly damps disturbances"
            )
        unstable, led = (
            _unstable(omega, values[:, columns], slopes[:, columns])
            for columns in (flock.free, flock.held)
        )
        return cls(omega, unstable, led)


def _changes(
    omega: FloatArray, values: ComplexArray, slopes: ComplexArray, most: FloatArray
) -> FloatArray:
    """Return the largest change in each interval, by values and by slopes, over that allowed."""
    by_values = (np.abs(_turned(values)) / most).max(axis=1)
    steep = (np.abs(slopes) / most).max(axis=1)
    by_slopes = np.diff(omega) * np.maximum(steep[1:], steep[:-1])
    return np.asarray(np.maximum(by_values, by_slopes))


def _turned(values: ComplexArray) -> ComplexArray:
    """Return the differences of consecutive logarithms, arguments within -pi..pi."""
    change = np.diff(values, axis=0)
    return np.asarray(change.real + 1j * np.angle(np.exp(1j * change.imag)))


def _unstable(omega: FloatArray, values: ComplexArray, slopes: ComplexArray) -> int:
    """Return the number of roots with a real part above 0 of a product of factors."""
    if not values.shape[1]:
        return 0
    # Far above all roots the argument is a / omega, its derivative Re d log / ds = -a / omega^2.
    rest = -omega[-1] * slopes[-1].real
    last = rest + np.angle(np.exp(1j * (values[-1].imag - rest)))
    whole = _turned(values).imag.sum() - last.sum()
    return round(float(-whole / np.pi))
