# SPDX-License-Identifier: Apache-2.0
"""The search for the interval of one bird's ratio, such as lambda, that keeps a flock together."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from flock_sim.physics.arrays import FloatArray, IntArray
from flock_sim.physics.flock import Flock
from flock_sim.theory.breakup import opening_gap, parts
from flock_sim.theory.equilibrium import Equilibrium

Trial = Callable[[FloatArray], IntArray]
"""Function of ratios (birds, members) that returns the gap that opens in each member.

The gap is 0 if the flock holds together. It is NO_GAP if the flock doesn't hold together and no gap
can be named.
"""

SteadyStates = Callable[[FloatArray], tuple[Flock, Equilibrium]]
"""Function of ratios (birds, members) that returns flocks with these ratios and their states."""

NO_GAP = -1

GRID = 200
"""Number of parts of the searched interval for cheap trials. The ends of parts are tried first."""

EXACT = 1e-13
"""Resolution of exact limits: the remaining error is the rounding of shares."""

BEYOND = 1e-4
"""Distance outside of an exact limit at which the breakup of the flock is computed."""


@dataclass(frozen=True)
class End:
    """One end of the interval of a ratio that keeps a formation."""

    ratio: float
    """The ratio, to half the resolution."""
    gap: int | None
    """The gap that opens beyond it; None if thrust balances drag at no speed."""
    parts: list[list[int]] | None = None
    """The groups of birds that fly on together beyond it, fastest first; None if not known."""


@dataclass(frozen=True)
class Limits:
    """The interval of one bird's ratio that keeps the formation, around its present ratio.

    The ratio is lambda, or T/T_0. If the present ratio doesn't keep the formation, this is the
    nearest interval that was found. An end is None if the searched interval keeps the formation up
    to its end on this side. Both are None if `never`: no ratio in the searched interval keeps the
    formation.
    """

    bird: int
    lower: End | None
    upper: End | None
    never: bool = False
    tried: tuple[tuple[float, int], ...] = ()
    """Each tried ratio, ascending, with the result of its trial."""

    @property
    def searched(self) -> tuple[float, float] | None:
        """The smallest and the largest tried ratio; None if none was tried.

        The smallest lambda is above the requested one if vortices of neighbours would meet below
        it.
        """
        return (self.tried[0][0], self.tried[-1][0]) if self.tried else None


def modified(
    present: FloatArray, birds: Sequence[int] | IntArray, ratios: Sequence[float] | FloatArray
) -> FloatArray:
    """Return the ratios `present` (birds,) with one modified per member, shape (birds, members).

    Member m has `ratios[m]` for the bird `birds[m]`.
    """
    changed = np.repeat(present[:, np.newaxis], len(ratios), axis=1)
    changed[np.asarray(birds) - 1, np.arange(len(ratios))] = ratios
    return changed


def limits_of_existence(
    steady_states: SteadyStates,
    present: FloatArray,
    birds: Sequence[int],
    lowest: Sequence[float],
    high: float,
) -> list[Limits]:
    """Return the limits of each of `birds` by the existence of steady states, to about 1e-13.

    The arguments are as in `search`.
    """

    def trial(ratios: FloatArray) -> IntArray:
        _, state = steady_states(ratios)
        return np.where(state.exists, 0, np.where(state.weakest_gap > 0, state.weakest_gap, NO_GAP))

    def with_parts(bird: int, end: End | None, outwards: float) -> End | None:
        """Add the parts of a flock beyond the limit; at the limit many gaps can be equally weak."""
        if end is None or end.gap is None:
            return end
        flock, state = steady_states(modified(present, [bird], [end.ratio + outwards * BEYOND]))
        groups = parts(flock, state, 0)
        return replace(end, gap=opening_gap(state, groups, 0) or end.gap, parts=groups)

    found = search(present, birds, lowest, high, EXACT, trial, GRID)
    return [
        replace(
            limits,
            lower=with_parts(limits.bird, limits.lower, -1.0),
            upper=with_parts(limits.bird, limits.upper, 1.0),
        )
        for limits in found
    ]


@dataclass
class _Bracket:
    """Two ratios of a bird: `inside` keeps the formation, `outside` doesn't."""

    bird: int
    inside: float
    outside: float
    gap: int

    @property
    def width(self) -> float:
        """Distance of the two ratios."""
        return abs(self.outside - self.inside)

    def end(self) -> End:
        return End(0.5 * (self.inside + self.outside), None if self.gap == NO_GAP else self.gap)


def search(
    present: FloatArray,
    birds: Sequence[int],
    lowest: Sequence[float],
    high: float,
    resolution: float,
    trial: Trial,
    grid: int = 1,
    sections: int = 2,
) -> list[Limits]:
    """Return the limits of each of `birds`, to `resolution`, by bisection.

    `present` (birds,) are the ratios of the flock. Those of one of `birds` are searched from its
    value in `lowest` to `high`. First the ends of `grid` equal parts of the interval are tried, and
    the bird's present ratio if it lies within. Then all brackets are narrowed at once: each round
    divides them into `sections`.
    """
    tried = []
    for bird, first in zip(birds, lowest, strict=True):
        own = present[bird - 1 : bird]
        within = own[(first <= own) & (own <= high)]
        marks = np.linspace(first, high, grid + 1) if first < high else np.empty(0)
        tried.append(np.unique(np.append(marks, within)))
    counts = [len(ratios) for ratios in tried]
    gaps = trial(modified(present, np.repeat(birds, counts), np.concatenate(tried)))
    verdicts: dict[int, dict[float, int]] = {bird: {} for bird in birds}

    never = set()
    brackets: dict[tuple[int, str], _Bracket] = {}
    for bird, ratios, opened in zip(birds, tried, np.split(gaps, np.cumsum(counts)[:-1])):
        verdicts[bird].update(zip(ratios.tolist(), opened.tolist()))
        kept = np.flatnonzero(opened == 0)
        if not len(kept):
            never.add(bird)
            continue
        start = int(kept[np.argmin(np.abs(ratios[kept] - present[bird - 1]))])
        for side, step in (("lower", -1), ("upper", 1)):
            outside = start
            while 0 <= outside < len(ratios) and opened[outside] == 0:
                outside += step
            if 0 <= outside < len(ratios):
                brackets[bird, side] = _Bracket(
                    bird, ratios[outside - step], ratios[outside], int(opened[outside])
                )
    _narrow(present, list(brackets.values()), resolution, trial, sections, verdicts)
    ends = {key: bracket.end() for key, bracket in brackets.items()}
    return [
        Limits(
            bird,
            ends.get((bird, "lower")),
            ends.get((bird, "upper")),
            bird in never,
            tuple(sorted(verdicts[bird].items())),
        )
        for bird in birds
    ]


def _narrow(
    present: FloatArray,
    brackets: list[_Bracket],
    resolution: float,
    trial: Trial,
    sections: int,
    verdicts: dict[int, dict[float, int]],
) -> None:
    """Narrow all brackets down to `resolution`, or to the spacing of floating-point numbers.

    The results of the trials are added to `verdicts`, by bird and ratio.
    """
    while wide := [b for b in brackets if b.width > max(resolution, 4.0 * np.spacing(b.outside))]:
        ratios = np.array(
            [np.linspace(b.inside, b.outside, sections + 1)[1:-1] for b in wide]
        )  # (brackets, sections - 1)
        birds = np.repeat([bracket.bird for bracket in wide], ratios.shape[1])
        gaps = trial(modified(present, birds, ratios.ravel())).reshape(ratios.shape)
        for bracket, between, opened in zip(wide, ratios, gaps):
            verdicts[bracket.bird].update(zip(between.tolist(), opened.tolist()))
            for ratio, gap in zip(between, opened):
                if gap:
                    bracket.outside, bracket.gap = float(ratio), int(gap)
                    break
                bracket.inside = float(ratio)
