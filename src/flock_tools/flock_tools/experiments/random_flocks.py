# SPDX-License-Identifier: Apache-2.0
"""Random flocks, in which every bird differs, and the fraction that can fly in formation."""

from __future__ import annotations

import itertools
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Any

import numpy as np

from flock_sim.analysis.metrics import plain
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.physics.arrays import FloatArray
from flock_sim.physics.flock import Flock
from flock_sim.theory.equilibrium import equilibrium
from flock_tools.experiments.workers import Workers

BLOCK = 2000
"""Largest number of flocks that are drawn and solved together."""

BLOCK_WORK = 10_000_000
"""Largest product of pairs, birds and flocks of a block: some seconds of all-to-all coupling."""

AHEAD = 8
"""Blocks submitted ahead per worker: all blocks at once might exceed the memory."""

CONFIDENCE = 0.95

SMALLEST = 0.5
"""Span ratios up to this are drawn anew, so that the vortices of neighbours do not meet."""

LARGEST = 10.0
"""Largest span ratio of a uniform distribution: a bird of ten times the span."""


@dataclass(frozen=True)
class Distribution:
    """The distribution of span ratios: normal about 1, or uniform."""

    spread: float
    """Standard deviation, before ratios that are too small are drawn anew."""
    between: tuple[float, float] | None = None
    """The ends of a uniform distribution; None: normal."""

    @classmethod
    def uniform(cls, low: float, high: float) -> Distribution:
        """Return the uniform distribution between two span ratios."""
        return cls((high - low) / 12.0**0.5, (low, high))

    @property
    def key(self) -> tuple[int, ...]:
        """The part of the random seed that stands for this distribution."""
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
    """A count out of a total, and the confidence interval of the probability."""

    count: int
    of: int

    @property
    def value(self) -> float:
        """The fraction; nan if the total is 0."""
        return self.count / self.of if self.of else np.nan

    @property
    def interval(self) -> tuple[float, float]:
        """Wilson's interval of 95 % confidence; (0, 1) if the total is 0."""
        if not self.of:
            return 0.0, 1.0
        from scipy.stats import binomtest  # scipy takes 0.5 s to import

        found = binomtest(self.count, self.of).proportion_ci(CONFIDENCE, method="wilson")
        return float(found.low), float(found.high)


@dataclass(frozen=True)
class Population:
    """Statistics of many random flocks of one size."""

    birds: int
    distribution: Distribution
    flying: Fraction
    """Flocks that can fly in formation."""
    broken_by_weakest: list[Fraction]
    """Flocks that can't, of those with the smallest bird at position 1 (tail) ... n (leader)."""
    weakest_gaps: list[int]
    """Numbers of flocks that can't in which gap 1, 2, ... has the least margin."""
    speed: float
    """Mean U* of flocks that can, in U_min."""
    drag_reduction: float
    """Mean eta of flocks that can."""

    @property
    def worst_position(self) -> int | None:
        """The position of the smallest bird with the largest broken fraction; None for none."""
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
    """Return statistics of `samples` random flocks of a configuration's size and coupling.

    The flocks depend only on `seed`, the distribution, the number of birds and the coupling, not on
    the workers. `on_progress` is called with the number of flocks just solved. Raises RunFailed as
    `equilibrium` does.
    """
    birds = configuration.birds
    pairs = birds * (birds - 1) // 2 if configuration.coupling == "all" else birds - 1
    block = min(BLOCK, max(1, BLOCK_WORK // (pairs * birds)))
    start = (seed, birds, *distribution.key)

    def submitted() -> Iterator[tuple[Future[_Tally], int]]:
        for number, first in enumerate(range(0, samples, block)):
            members, key = min(block, samples - first), (*start, number)
            yield (
                workers.executor.submit(_judged, configuration, distribution, key, members),
                members,
            )

    blocks, tallies = submitted(), []
    waiting = deque(itertools.islice(blocks, AHEAD * workers.count))
    try:
        while waiting:
            future, members = waiting.popleft()
            tallies.append(future.result())
            on_progress(members)
            waiting.extend(itertools.islice(blocks, 1))
    finally:
        for future, _ in waiting:
            future.cancel()
    return _Tally.total(tallies).population(birds, distribution)


@dataclass(frozen=True)
class _Tally:
    """Counts and sums of a block of flocks. Those of all blocks are added."""

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
