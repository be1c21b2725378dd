# SPDX-License-Identifier: Apache-2.0
"""The verdict on a flight: whether the flock holds, settles, comes apart, or a bird has stalled.

It is decided from recorded positions and speeds alone, so it needs no theory and works for any
links. docs/model.md describes it, and when it can be wrong.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from flock_sim.physics.arrays import BoolArray, FloatArray
from flock_sim.physics.scaling import Scales

HOLDS, SETTLING, APART, STALLED = WORDS = ("holds", "settling", "apart", "stalled")

MOST_ROWS = 200
"""Largest number of recorded steps that a verdict is decided from."""

FEWEST_ROWS = 8
"""Number of recorded steps in the second half of a flight below which it can't be judged."""

SHORTEST = 10.0
"""Shortest flight that can be judged, in times in which its drag alone would stop a bird."""

CHANGE = 0.02
"""Largest change of a gap that holds, over the gap, or over 1 b if the gap is smaller."""

DECAY = 0.8
"""Largest ratio of successive changes of a gap from which its final value is extrapolated."""

SWELL = 2.0
"""Largest ratio of the fluctuations in two successive quarters of a flight that holds."""

WIDE = 20.0
"""Smallest gap by which birds can be apart, in b. There, a pair lacks 1e-3 of its full saving."""

STEADY = 0.8
"""Smallest ratio of the last to the first speed of opening of a gap by which birds are apart."""

LASTING = 0.5
"""Smallest part of the speed of opening that lasts, as extrapolated, if birds are apart."""

TREND = 3.0
"""Smallest ratio of the growth of a gap to its fluctuations if birds are apart."""


@dataclass(frozen=True)
class Verdicts:
    """The verdicts on the members of a flight; lists have one entry per member."""

    verdict: list[str]
    """One of WORDS."""
    verdict_reason: list[str]
    stalled_at: list[float | None]
    """The first recorded time at which a bird has stalled, in b / U_min; None without one."""
    stalled_bird: list[int | None]
    """The bird that has stalled, from 1; None without one."""

    def as_json(self) -> dict[str, object]:
        """Return plain lists by name."""
        return dict(vars(self))

    def counts(self) -> dict[str, int]:
        """Return the number of members with each of WORDS."""
        return {word: self.verdict.count(word) for word in WORDS}

    def counted(self) -> str:
        """Return the number of members with each verdict that occurs, such as `3 holds`."""
        return ", ".join(f"{count} {word}" for word, count in self.counts().items() if count)


@dataclass(frozen=True)
class Stall:
    """A bird that has stalled: its speed was found not to be above 0, or not to be finite."""

    bird: int
    """From 1."""
    time: float
    """The first recorded time at which this was found, in b / U_min."""


def collected(
    members: int, judged: dict[int, tuple[str, str]], stalls: dict[int, Stall]
) -> Verdicts:
    """Return the verdicts of all members: `judged` by `judge`, or stalled. Keys count from 0."""
    words = [(STALLED, _stalled(stalls[m])) if m in stalls else judged[m] for m in range(members)]
    found = [stalls.get(m) for m in range(members)]
    return Verdicts(
        [word for word, _ in words],
        [reason for _, reason in words],
        [stall.time if stall else None for stall in found],
        [stall.bird if stall else None for stall in found],
    )


def _stalled(stall: Stall) -> str:
    return f"the speed of bird {stall.bird} is not above 0 at t = {stall.time:g}"


def flies(position: FloatArray, speed: FloatArray) -> BoolArray:
    """Return, in the shape of both, whether a bird flies: finite, and with a speed above 0.

    The model ends at the pole of U^-2. A bird can't get back across it, except by a push.
    """
    return np.asarray(np.isfinite(position) & np.isfinite(speed) & (speed > 0.0))


def first_stalled(before: FloatArray, flying: BoolArray) -> int:
    """Return the bird, from 1, that has stalled first of those that are not `flying`, (birds,).

    It is the one that was slowest `before`, at the recorded step before this one.
    """
    return int(np.argmin(np.where(flying, np.inf, before))) + 1


def shortest_time(scales: Scales) -> float:
    """Return the duration below which a flight can't be judged, in b / U_min."""
    return SHORTEST * scales.mass_ratio * scales.cruise_speed / scales.cruise_drag


def judge(
    time: FloatArray, position: FloatArray, start: float, shortest: float
) -> list[tuple[str, str]]:
    """Return verdict and reason of each member from the second half of its flight.

    `time`, shape (rows,), and `position`, (rows, birds, members), are those of evenly spaced
    recorded steps. The flight begins at `start`, or with the last push. Only the rows in its
    second half are used. `shortest` is that of `shortest_time`.
    """
    members = position.shape[2]
    duration = float(time[-1]) - start
    if position.shape[1] == 1:
        return [(HOLDS, "there is one bird")] * members
    if duration < shortest:
        since = "undisturbed for" if start else "of"
        reason = f"a flight {since} {duration:g} b/U_min is too short: {shortest:.0f} are needed"
        return [(SETTLING, reason)] * members
    late = time >= start + 0.5 * duration
    if np.count_nonzero(late) < FEWEST_ROWS:
        reason = f"fewer than {FEWEST_ROWS} steps of the second half are recorded"
        return [(SETTLING, reason)] * members
    with np.errstate(all="ignore"):
        gaps = _Gaps.of(time[late], np.diff(position[late], axis=1))
        apart, quiet, bounded = gaps.apart(), gaps.quiet(), gaps.bounded()
    return [_verdict(apart[:, m], quiet[:, m], bounded[:, m]) for m in range(members)]


def _verdict(apart: BoolArray, quiet: BoolArray, bounded: BoolArray) -> tuple[str, str]:
    """Return verdict and reason of a flock from what its gaps do, shape (gaps,)."""
    if apart.any():
        return APART, f"{_gap(apart)} opens steadily"
    restless = ~(quiet | bounded)
    if restless.any():
        return SETTLING, f"{_gap(restless)} still changes"
    if quiet.all():
        return HOLDS, "no gap changes"
    return HOLDS, f"{_gap(~quiet)} fluctuates, but does not grow"


def _gap(chosen: BoolArray) -> str:
    bird = int(np.argmax(chosen)) + 1
    return f"gap {bird} to {bird + 1}"


@dataclass(frozen=True)
class _Gaps:
    """The gaps in the second half of a flight, in four windows; arrays end with (gaps, members)."""

    last: FloatArray
    """Mean gap in the last window, in b."""
    opening: FloatArray
    """Speed at which the distance grows from window to window, shape (3, ...), in U_min."""
    distance: FloatArray
    """Mean distance of two successive windows, shape (3, ...), in b."""
    step: float
    """Time from window to window, in b / U_min."""
    change: FloatArray
    """Difference of the means of the two quarters, in b."""
    scatter: FloatArray
    """Standard deviation about a line through each quarter, shape (2, ...), in b."""

    @classmethod
    def of(cls, time: FloatArray, gap: FloatArray) -> _Gaps:
        """Return the course of `gap`, shape (rows, gaps, members), over `time`, (rows,)."""
        windows = np.array_split(np.arange(len(time)), 4)
        mean = np.array([gap[rows].mean(axis=0) for rows in windows])
        middle = np.array([time[rows].mean() for rows in windows])
        half = len(time) // 2
        quarters = [slice(half), slice(half, None)]
        speed = np.diff(mean, axis=0) / np.diff(middle)[:, np.newaxis, np.newaxis]
        earlier, later = (gap[rows].mean(axis=0) for rows in quarters)
        return cls(
            mean[-1],
            speed * np.sign(mean[-1]),
            np.abs(0.5 * (mean[1:] + mean[:-1])),
            float(middle[-1] - middle[0]) / 3.0,
            np.abs(later - earlier),
            np.array([_about_line(time[rows], gap[rows]) for rows in quarters]),
        )

    def quiet(self) -> BoolArray:
        """Return whether a gap has reached its final value, as extrapolated, within CHANGE."""
        first, second, third = self.opening
        ratio = np.maximum(second / first, third / second)
        decays = (first * second > 0.0) & (second * third > 0.0) & (ratio < DECAY)
        rest = np.abs(third) * self.step * ratio / (1.0 - ratio)
        most = CHANGE * np.maximum(np.abs(self.last), 1.0)
        recent = (np.abs(second) + np.abs(third)) * self.step
        remaining = np.where(decays, rest, recent)
        return np.asarray((remaining <= most) & (self.scatter[1] <= most))

    def bounded(self) -> BoolArray:
        """Return whether a gap fluctuates more than it drifts, and as much as a quarter before."""
        swell = self.scatter[1] / self.scatter[0]
        return np.asarray(
            (self.change <= self._typical()) & (swell <= SWELL) & (swell >= 1.0 / SWELL)
        )

    def apart(self) -> BoolArray:
        """Return whether a gap is wide and opens at a speed that lasts.

        In the full wake, a pair's drag changes as 1 / X^2, and so does the speed of opening:
        v = v_inf + c / X^2. A gap that opens with v_inf > 0 never closes. As long as another wide
        gap closes, the speeds are not final.
        """
        first, _, third = self.opening
        near, _, far = self.distance * self.distance
        lasting = (third * far - first * near) / (far - near)
        wide = np.abs(self.last) >= WIDE
        opens = (
            wide
            & (self.opening > 0.0).all(axis=0)
            & (third >= STEADY * first)
            & (lasting >= LASTING * third)
            & (self.change >= TREND * self._typical())
        )
        return np.asarray(opens & ~(wide & (third < 0.0)).any(axis=0))

    def _typical(self) -> FloatArray:
        """Return the fluctuation in both quarters, in b."""
        return np.asarray(np.sqrt((self.scatter * self.scatter).mean(axis=0)))


def _about_line(time: FloatArray, values: FloatArray) -> FloatArray:
    """Return the standard deviation of `values`, (rows, ...), about their regression line."""
    x = time - time.mean()
    y = values - values.mean(axis=0)
    slope = np.tensordot(x, y, axes=1) / (x @ x)
    off = y - x[:, np.newaxis, np.newaxis] * slope
    return np.asarray(np.sqrt((off * off).mean(axis=0)))


def evenly(first: int, last: int, most: int = MOST_ROWS) -> Sequence[int]:
    """Return at most `most` evenly spaced integers that end with `last`, none below `first`."""
    stride = -(-(last - first + 1) // most)
    return range(last - (last - first) // stride * stride, last + 1, stride)
