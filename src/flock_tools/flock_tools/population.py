# SPDX-License-Identifier: Apache-2.0
"""Random flocks, in which every bird differs, and how many of them can fly in formation."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import binomtest

from flock_sim.core.configuration import FlockConfiguration
from flock_sim.core.equilibrium import equilibrium
from flock_sim.core.flock import Flock
from flock_sim.core.kernel import FloatArray
from flock_sim.core.metrics import plain
from flock_tools.workers import Workers

BLOCK = 2000
"""Flocks that are drawn and solved together, at most."""

BLOCK_WORK = 10_000_000
"""Pairs times birds of a block at most: some seconds of all-to-all coupling, to be stopped in."""

CONFIDENCE = 0.95

SMALLEST = 0.5
"""Span ratios are drawn anew until they are above this, so that no neighbours' vortices meet."""

LARGEST = 10.0
"""Span ratios above which nobody asks: a bird of ten times the span."""


@dataclass(frozen=True)
class Distribution:
    """How span ratios are drawn: normal about 1, or uniform."""

    spread: float
    """Standard deviation, before what is too small is drawn anew."""
    between: tuple[float, float] | None = None
    """The ends of a uniform distribution; None: normal."""

    @classmethod
    def uniform(cls, low: float, high: float) -> Distribution:
        """Return the uniform distribution between two span ratios."""
        return cls((high - low) / 12.0**0.5, (low, high))

    @property
    def key(self) -> tuple[int, ...]:
        """What random numbers of this distribution are seeded with."""
        numbers = (self.spread,) if self.between is None else self.between
        return tuple(int(word) for word in np.array(numbers).view(np.uint64))

    def draw(self, random: np.random.Generator, birds: int, members: int) -> FloatArray:
        """Return span ratios, shape (birds, members)."""
        shape = (birds, members)
        if self.between is not None:
            return random.uniform(*self.between, shape)
        ratio = random.normal(1.0, self.spread, shape)
        while (small := ratio <= SMALLEST).any():
            ratio[small] = random.normal(1.0, self.spread, int(small.sum()))
        return ratio


@dataclass(frozen=True)
class Fraction:
    """A number out of a number, and the interval in which the probability behind it lies."""

    count: int
    of: int

    @property
    def value(self) -> float:
        """The fraction itself; nan of nothing."""
        return self.count / self.of if self.of else np.nan

    @property
    def interval(self) -> tuple[float, float]:
        """Wilson's interval of 95 % confidence; (0, 1) of nothing."""
        if not self.of:
            return 0.0, 1.0
        found = binomtest(self.count, self.of).proportion_ci(CONFIDENCE, method="wilson")
        return float(found.low), float(found.high)


@dataclass(frozen=True)
class Population:
    """What became of many random flocks of one size."""

    birds: int
    distribution: Distribution
    flying: Fraction
    """Flocks that can fly in formation."""
    broken_by_weakest: list[Fraction]
    """Flocks that can't, of those whose smallest bird has wing position 1 (tail) ... n (leader)."""
    weakest_gaps: list[int]
    """Of the flocks that can't, in how many gap 1, 2, ... has the least margin."""
    speed: float
    """Mean U* of those that can, in U_min."""
    drag_reduction: float
    """Mean eta of those that can."""

    @property
    def worst_position(self) -> int | None:
        """The wing position whose smallest bird breaks flocks most; None where none breaks."""
        if not any(fraction.count for fraction in self.broken_by_weakest):
            return None
        rates = [fraction.value for fraction in self.broken_by_weakest]
        return int(np.nanargmax(rates)) + 1

    def as_json(self) -> dict[str, Any]:
        """Return plain numbers."""
        lower, upper = self.flying.interval
        facts = {
            "birds": self.birds,
            "spread": self.distribution.spread,
            "uniform": self.distribution.between,
            "samples": self.flying.of,
            "flying": self.flying.count,
            "fraction": self.flying.value,
            "confidence_interval": [lower, upper],
            "broken_by_weakest": [fraction.value for fraction in self.broken_by_weakest],
            "broken_by_weakest_interval": [broken.interval for broken in self.broken_by_weakest],
            "weakest_at": [fraction.of for fraction in self.broken_by_weakest],
            "worst_position": self.worst_position,
            "weakest_gaps": self.weakest_gaps,
            "mean_speed": self.speed,
            "mean_drag_reduction": self.drag_reduction,
        }
        return {name: plain(value) for name, value in facts.items()}


def survey(
    configuration: FlockConfiguration,
    distribution: Distribution,
    samples: int,
    seed: int,
    workers: Workers,
    on_progress: Callable[[int], None] = lambda flocks: None,
) -> Population:
    """Return what becomes of `samples` flocks of a configuration's size and coupling.

    The flocks depend on `seed`, the distribution, the number of birds and the coupling only, not on
    who computes. `on_progress` is called with the number of flocks just solved. Raises RunFailed as
    `equilibrium` does.
    """
    birds = configuration.birds
    pairs = birds * (birds - 1) // 2 if configuration.coupling == "all" else birds - 1
    block = min(BLOCK, max(1, BLOCK_WORK // (pairs * birds)))
    blocks = [min(block, samples - first) for first in range(0, samples, block)]
    start = (seed, birds, *distribution.key)
    futures = [
        workers.executor.submit(_judged, configuration, distribution, (*start, number), members)
        for number, members in enumerate(blocks)
    ]
    tallies = []
    try:
        for future, members in zip(futures, blocks):
            tallies.append(future.result())
            on_progress(members)
    finally:
        for future in futures:
            future.cancel()
    return _Tally.total(tallies).population(birds, distribution)


@dataclass(frozen=True)
class _Tally:
    """Counts and sums of a block of flocks, which add up over blocks."""

    flying: int
    weakest: np.ndarray
    broken: np.ndarray
    weakest_gaps: np.ndarray
    speed: float
    drag_reduction: float

    @classmethod
    def total(cls, tallies: list[_Tally]) -> _Tally:
        return cls(*(sum(column) for column in zip(*(vars(tally).values() for tally in tallies))))

    def population(self, birds: int, distribution: Distribution) -> Population:
        flying = Fraction(self.flying, int(self.weakest.sum()))
        return Population(
            birds,
            distribution,
            flying,
            [Fraction(int(k), int(n)) for k, n in zip(self.broken, self.weakest)],
            [int(k) for k in self.weakest_gaps],
            self.speed / self.flying if self.flying else np.nan,
            self.drag_reduction / self.flying if self.flying else np.nan,
        )


def _judged(
    configuration: FlockConfiguration,
    distribution: Distribution,
    seed: tuple[int, ...],
    members: int,
) -> _Tally:
    """Draw a block of flocks and solve for their steady states."""
    birds = configuration.birds
    ratio = distribution.draw(np.random.default_rng(seed), birds, members)
    state = equilibrium(Flock.of(configuration, ratio))
    smallest = np.argmin(ratio, axis=0)
    position = np.minimum(smallest, birds - 1 - smallest)
    positions = (birds + 1) // 2
    return _Tally(
        int(state.exists.sum()),
        np.bincount(position, minlength=positions),
        np.bincount(position[~state.exists], minlength=positions),
        np.bincount(state.weakest_gap[~state.exists], minlength=birds)[1:birds],
        float(np.nansum(state.speed)),
        float(np.nansum(state.drag_reduction.mean(axis=0))),
    )
