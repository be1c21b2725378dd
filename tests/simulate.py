# SPDX-License-Identifier: Apache-2.0
"""Random simulated flights with all faults, until enough steps are flown: `make simulate`.

    simulate.py [--steps N] [--first-seed S] [--jobs J]
    simulate.py --seed S        flies the flight of one seed again

A step is a Runge-Kutta step of one bird: four stages that its protocol has computed. Steps that are
flown again after a rewind count again. Each state must equal that of the reference, and once all
faults are over, the flight must end within the number of deliveries that
`support/simulator/liveness.py` derives. Prints what the flights came to.
"""

from __future__ import annotations

import argparse
import itertools
import os
import sys
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from contextlib import nullcontext
from dataclasses import dataclass, field
from multiprocessing import get_context

from flock_sim.physics.runge_kutta import STAGES
from support.simulator.random_flight import RandomFlight

STEPS = 1_000_000
BATCH = 100
"""Seeds of each process between two looks at the number of steps."""


class SeedFailed(AssertionError):
    """A flight that violates a claim; its text names the seed."""


@dataclass
class Toll:
    """What happened in the flights of several seeds."""

    flights: int = 0
    ticks: int = 0
    deliveries: int = 0
    events: Counter[str] = field(default_factory=Counter)
    largest: tuple[float, int] = (0.0, -1)
    """The largest ratio of the needed deliveries to their bound, and its seed."""
    largest_again: tuple[float, int] = (0.0, -1)
    """The same among flights in which epochs might begin after the last fault."""
    digests: list[str] = field(default_factory=list)

    @property
    def steps(self) -> int:
        return self.ticks // STAGES

    def add(self, other: Toll) -> None:
        self.flights += other.flights
        self.ticks += other.ticks
        self.deliveries += other.deliveries
        self.events += other.events
        self.largest = max(self.largest, other.largest)
        self.largest_again = max(self.largest_again, other.largest_again)
        self.digests += other.digests

    def __str__(self) -> str:
        events = ", ".join(f"{count} {name}" for name, count in sorted(self.events.items()))
        (ratio, seed), (again, again_seed) = self.largest, self.largest_again
        return (
            f"{self.steps} steps of birds in {self.flights} flights, {self.deliveries} deliveries\n"
            f"{events}\n"
            "every state equals the reference's bit for bit\n"
            f"deliveries after the last fault: at most {ratio:.3f} of the bound (seed {seed}), and "
            f"{again:.3f} where epochs may begin (seed {again_seed})"
        )


def fly(seed: int) -> Toll:
    """Fly the flight of a seed. Raises SeedFailed if it violates a claim."""
    flight = RandomFlight(seed)
    try:
        flight.fly()
    except Exception as error:
        again = f"fly it again: ./flock python tests/simulate.py --seed {seed}"
        raise SeedFailed(f"seed {seed}: {type(error).__name__}: {error}\n{again}") from error
    world = flight.world
    ratio = world.needed / max(1, world.bound)
    toll = Toll(1, world.ticks, world.wires.deliveries, flight.events, (ratio, seed))
    if world.most_epochs:
        toll.largest_again = ratio, seed
    toll.digests.append(world.wires.digest)
    return toll


def fly_steps(steps: int, first_seed: int = 0, jobs: int = 1) -> Toll:
    """Fly the flights of the seeds from `first_seed` on, until `steps` are flown."""
    toll = Toll()
    with ProcessPoolExecutor(jobs, get_context("spawn")) if jobs > 1 else nullcontext() as pool:
        for first in itertools.count(first_seed, BATCH * jobs):
            seeds = range(first, first + BATCH * jobs)
            for one in pool.map(fly, seeds) if pool else map(fly, seeds):
                toll.add(one)
                if toll.steps >= steps:
                    return toll
            if sys.stderr.isatty():
                print(f"\r{toll.steps} of {steps} steps", end="", file=sys.stderr, flush=True)
    raise AssertionError


def main() -> int:
    """Fly simulated flights and print what they came to."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=STEPS)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--seed", type=int)
    options = parser.parse_args()
    if options.seed is not None:
        toll = fly(options.seed)
        print(f"digest of all events: {toll.digests[0]}")
    else:
        toll = fly_steps(options.steps, options.first_seed, options.jobs)
    print(toll)
    return 0


if __name__ == "__main__":
    sys.exit(main())
