# SPDX-License-Identifier: Apache-2.0
"""The linear response of flocks at their steady states: gains, H-infinity norms, gusts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from flock_sim.physics import formation
from flock_sim.physics.arrays import FloatArray
from flock_sim.physics.flock import Flock
from flock_sim.response.chain import Chain
from flock_sim.response.dense import Dense
from flock_sim.response.elimination import ComplexArray
from flock_sim.response.frequencies import Frequencies, Responses
from flock_sim.response.gibbs import gap_distributions
from flock_sim.response.gust import variances_by_covariance, variances_by_frequency
from flock_sim.response.peaks import Peaks, peaks
from flock_sim.theory.delayed.linearisation import LINEAR, DelayedLinearisation
from flock_sim.theory.delayed.stability import steady_flight

ROUNDING = 1e-13
"""Logarithm of a gain that is 1 but for rounding."""

BETWEEN = 0.5
"""Logarithm of the factor by which a gain between two frequencies may exceed that at both."""


class SteadyState(Protocol):
    """A steady state of an ensemble, such as an `Equilibrium`."""

    @property
    def spacing(self) -> FloatArray:
        """x_{i+1} - x_i, shape (birds - 1, members), in b."""

    @property
    def speed(self) -> FloatArray:
        """U*, shape (members,), in U_min."""


@dataclass(frozen=True)
class Gust:
    """The stationary state in white accelerations dU = STD dW of all birds; nan if none exists."""

    std: float
    """STD, in U_min per sqrt(b / U_min)."""
    gap_std: FloatArray
    """Standard deviation of x_{i+1} - x_i, shape (members, birds - 1), in b."""
    bird_speed_std: FloatArray
    """Standard deviation of U_i, shape (members, birds), in U_min."""
    mean_speed_std: FloatArray
    """Standard deviation of the mean speed of the birds, shape (members,), in U_min."""
    speed_spread_rms: FloatArray
    """Root mean square of sigma_U, shape (members,), in U_min."""
    gap_mean_gibbs: FloatArray
    """Mean of x_{i+1} - x_i by the estimate of `gibbs`, shape (members, birds - 1), in b.

    nan for all-to-all coupling and with a lag, where forces have no potential of single gaps.
    """
    gap_std_gibbs: FloatArray
    """Standard deviation by the same estimate."""


@dataclass(frozen=True)
class Response:
    """The linear responses of all members of a flock; nan if no stable steady state exists."""

    exists: npt.NDArray[np.bool_]
    """Whether a steady state exists, shape (members,)."""
    stable: npt.NDArray[np.bool_]
    """Whether it exists and small disturbances decay."""
    speed: FloatArray
    """U*, shape (members,), in U_min."""
    spacing: FloatArray
    """x_{i+1} - x_i, shape (members, birds - 1), in b."""
    speed_gain_peak: FloatArray
    """Largest |u_i / u_leader| over all frequencies, with the leader's speed prescribed.

    Shape (members, birds). It is 1 or more, since all birds follow slow changes.
    """
    speed_gain_frequency: FloatArray
    """Its frequency omega, in U_min / b."""
    neighbour_gain_peak: FloatArray
    """The same of a bird over its neighbour nearer to the leader, shape (members, birds - 1)."""
    neighbour_gain_frequency: FloatArray
    """Its frequency, in U_min / b."""
    hinf_gaps: FloatArray
    """Largest singular value over all frequencies from accelerations of all birds to all gaps.

    Shape (members,), in (b / U_min)^2. It is 0 for a bird alone.
    """
    hinf_gaps_frequency: FloatArray
    """Its frequency, in U_min / b."""
    hinf_gaps_from_leader: FloatArray
    """The same from the acceleration of the leader alone, shape (members,)."""
    hinf_gaps_from_leader_frequency: FloatArray
    """Its frequency, in U_min / b."""
    gust: Gust | None


def linear_response(
    flock: Flock,
    *,
    lag: float = 0.0,
    model: str = LINEAR,
    gust: float | None = None,
    on_member: Callable[[int], None] = lambda members: None,
) -> Response:
    """Return the linear responses of all members of `flock`.

    Birds know their neighbours `lag` late, in b / U_min, and use a late state as `model` says, one
    of `delayed.linearisation.MODELS`. `gust` is the standard deviation STD of white accelerations.
    `on_member` is called with 1 after each member. Raises ValueError for an unknown model or a lag
    that is negative or not finite, RunFailed if a steady state or a response can't be computed.
    """
    birds, members = flock.birds, flock.members
    found = Response(
        exists=np.zeros(members, dtype=bool),
        stable=np.zeros(members, dtype=bool),
        speed=np.full(members, np.nan),
        spacing=np.full((members, birds - 1), np.nan),
        speed_gain_peak=np.full((members, birds), np.nan),
        speed_gain_frequency=np.full((members, birds), np.nan),
        neighbour_gain_peak=np.full((members, birds - 1), np.nan),
        neighbour_gain_frequency=np.full((members, birds - 1), np.nan),
        hinf_gaps=np.full(members, np.nan),
        hinf_gaps_frequency=np.full(members, np.nan),
        hinf_gaps_from_leader=np.full(members, np.nan),
        hinf_gaps_from_leader_frequency=np.full(members, np.nan),
        gust=None if gust is None else _no_gust(gust, birds, members),
    )
    for m in range(members):
        one = flock.select(np.array([m]))
        found.spacing[m], found.speed[m] = steady_flight(one, lag, model if lag else LINEAR)
        if np.isfinite(found.speed[m]):
            found.exists[m] = True
            motion = DelayedLinearisation.of(one, found.spacing[m], found.speed[m], lag, model)
            _fill(found, m, one, motion)
        on_member(1)
    return found


def frequency_response(
    flock: Flock,
    state: SteadyState,
    omega: FloatArray | float,
    *,
    lag: float = 0.0,
    model: str = LINEAR,
    member: int = 0,
) -> ComplexArray:
    """Return the responses to an acceleration exp(i omega t) of each bird, in their steady state.

    `omega` are frequencies in U_min / b, 0 or more, shape (frequencies,) or one. The result has
    shape (frequencies, 2 birds - 1, birds): for each accelerated bird the complex amplitudes of all
    speeds, in b / U_min, and of all gaps x_{i+1} - x_i, in (b / U_min)^2, per U_min^2 / b. `state`
    is the steady state at this `lag`; `lag` and `model` are as for `linear_response`, and `member`
    is an index.
    """
    one = flock.select(np.array([member]))
    speed = float(state.speed[member])
    motion = DelayedLinearisation.of(one, state.spacing[:, member], speed, lag, model)
    return responses_of(one, motion).responses(np.atleast_1d(np.asarray(omega, dtype=float)))


def responses_of(flock: Flock, motion: DelayedLinearisation) -> Responses:
    """Return the responses of a flock of one member: those of a chain, where it is one."""
    chain = flock.coupling == "nearest" or flock.birds <= 2
    return Chain(motion) if chain else Dense(motion)


def neighbour_pairs(birds: int) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Return for each gap the index of its outer bird, and that of the one nearer to the leader."""
    gap = np.arange(birds - 1)
    left = gap < formation.leader(birds) - 1
    return np.where(left, gap, gap + 1), np.where(left, gap + 1, gap)


def _no_gust(std: float, birds: int, members: int) -> Gust:
    gaps = [np.full((members, birds - 1), np.nan) for _ in range(3)]
    singles = [np.full(members, np.nan) for _ in range(2)]
    return Gust(std, gaps[0], np.full((members, birds), np.nan), *singles, *gaps[1:])


def _fill(found: Response, m: int, flock: Flock, motion: DelayedLinearisation) -> None:
    """Fill the values of member m, from its equations of motion."""
    responses = responses_of(flock, motion)
    frequencies = Frequencies.of(responses)
    found.stable[m] = frequencies.unstable == 0
    if not found.stable[m]:
        return
    omega = frequencies.omega
    if not frequencies.unstable_led:
        gains = _gain_peaks(responses, omega)
        value, birds = np.exp(gains.value), flock.birds
        found.speed_gain_peak[m], found.neighbour_gain_peak[m] = value[:birds], value[birds:]
        found.speed_gain_frequency[m] = gains.frequency[:birds]
        found.neighbour_gain_frequency[m] = gains.frequency[birds:]
    if flock.birds == 1:
        for values in (found.hinf_gaps, found.hinf_gaps_from_leader):
            values[m] = 0.0
        for values in (found.hinf_gaps_frequency, found.hinf_gaps_from_leader_frequency):
            values[m] = 0.0
    else:
        highest = _highest_frequencies(responses, omega)
        found.hinf_gaps[m], found.hinf_gaps_frequency[m] = _gap_peak(
            responses.largest_gains, highest
        )
        found.hinf_gaps_from_leader[m], found.hinf_gaps_from_leader_frequency[m] = _gap_peak(
            responses.from_leader, omega
        )
    if found.gust is not None:
        _fill_gust(found.gust, m, flock, found.spacing[m], motion, responses, omega)


def _gain_peaks(responses: Responses, omega: FloatArray) -> Peaks:
    """Return the peaks of the gains over the leader, and of those over the neighbour."""
    outer, inner = neighbour_pairs(responses.birds)

    def curves(omega: FloatArray) -> tuple[FloatArray, FloatArray]:
        gains, slopes = responses.followings(omega)
        return (
            np.column_stack([gains, gains[:, outer] - gains[:, inner]]),
            np.column_stack([slopes, slopes[:, outer] - slopes[:, inner]]),
        )

    found = peaks(curves, omega, *curves(omega))
    # At omega = 0 all birds move alike, with a gain of 1.
    level = np.abs(found.value) <= ROUNDING
    return Peaks(np.where(level, 0.0, found.value), np.where(level, 0.0, found.frequency))


def _gap_peak(
    curve: Callable[[FloatArray], tuple[FloatArray, FloatArray]], omega: FloatArray
) -> tuple[float, float]:
    """Return the largest value of exp(curve), and its frequency."""

    def curves(omega: FloatArray) -> tuple[FloatArray, FloatArray]:
        values, slopes = curve(omega)
        return values[:, np.newaxis], slopes[:, np.newaxis]

    peak = peaks(curves, omega, *curves(omega))
    return float(np.exp(peak.value[0])), float(peak.frequency[0])


def _highest_frequencies(responses: Responses, omega: FloatArray) -> FloatArray:
    """Return the frequencies at which the largest singular value may be the largest of all.

    The sum of the squares of all singular values is an upper bound on the square, and known from
    the densities. The frequencies next to these are included.
    """
    gaps = responses.birds - 1
    bound = 0.5 * np.log(responses.densities(omega)[:, :gaps].sum(axis=1))
    known = responses.largest_gains(omega[[np.argmax(bound)]])[0][0]
    high = np.pad(bound + BETWEEN >= known, 1)
    return np.asarray(omega[high[1:-1] | high[2:] | high[:-2]])


def _fill_gust(
    gust: Gust,
    m: int,
    flock: Flock,
    spacing: FloatArray,
    motion: DelayedLinearisation,
    responses: Responses,
    omega: FloatArray,
) -> None:
    birds, gaps = flock.birds, flock.birds - 1
    if isinstance(responses, Chain) or motion.lag > 0.0:
        variances = variances_by_frequency(responses.densities, omega)
    else:
        variances = variances_by_covariance(motion)
    std = gust.std * np.sqrt(variances)
    gust.gap_std[m], gust.bird_speed_std[m] = std[:gaps], std[gaps:-1]
    gust.mean_speed_std[m] = std[-1]
    # <sigma_U^2> is the mean variance of a speed less the variance of the mean speed.
    spread = variances[gaps:-1].mean() - variances[-1]
    gust.speed_spread_rms[m] = gust.std * np.sqrt(max(spread, 0.0)) if birds > 1 else 0.0
    if isinstance(responses, Chain) and motion.lag == 0.0:
        gust.gap_mean_gibbs[m], gust.gap_std_gibbs[m] = gap_distributions(
            flock, spacing, std[:gaps]
        )
