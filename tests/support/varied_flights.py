# SPDX-License-Identifier: Apache-2.0
"""Random flights whose recordings differ as much as possible, for the tools that read them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from random import Random

from flock_sim.bag.directory import METADATA_FILE
from flock_sim.configuration.flock_configuration import FlockConfiguration

SIZES = (1, 2, 2, 3, 4, 4, 5, 6, 7, 8, 13, 16, 31)
LARGE = (60, 101)
"""Numbers of birds; every tenth flight is a large one."""

MOST_STATES = 15_000
"""Largest number of recorded states of a bird and a member."""

KINDS = ("equal", "unequal", "parted", "diverged", "stalled", "members")


def varied_flight(random: Random, kind: str) -> FlockConfiguration:
    """Return a flight of one of KINDS."""
    birds = random.choice(LARGE) if random.random() < 0.1 else random.choice(SIZES)
    flight = FlockConfiguration(
        birds=birds,
        coupling=random.choice(["nearest", "all"]) if birds <= 31 else "nearest",
        t_max=random.choice([0.0, 5.0, 40.0, 300.0, 4000.0]) or 10.0,
    )
    if kind in ("unequal", "members"):
        flight = replace(flight, span_ratios=_unequal(random, birds, kind == "members"))
    if kind == "parted":
        small = random.randint(1, birds)
        flight = replace(flight, t_max=6000.0, span_ratios=(f"{small}={random.uniform(0.6, 0.8)}",))
    if kind == "diverged":
        dt = 10.0 ** random.randint(2, 6)
        flight = replace(flight, dt=dt, t_max=dt * random.choice([1, 2, 3, 30]))
    if kind == "stalled":
        bird, back = random.randint(1, birds), random.uniform(-0.9, -0.6)
        flight = replace(flight, t_max=1000.0, perturbations=(f"{bird}@200=0,{back:.3f}",))
    rows = max(1, MOST_STATES // (birds * flight.members))
    least = -(-flight.steps // rows)
    return replace(flight, record_every=max(least, random.choice([1, 1, 3, 10])))


def _unequal(random: Random, birds: int, members: bool) -> tuple[str, ...]:
    count = random.randint(2, 4) if members else 1
    return tuple(
        f"{bird}=" + ",".join(f"{random.uniform(0.85, 1.15):.4f}" for _ in range(count))
        for bird in random.sample(range(1, birds + 1), k=random.randint(1, birds))
    )


def cut(random: Random, bag: Path) -> None:
    """Cut the file of a bag off in its second half, as a kill leaves it."""
    (file,) = bag.glob("*.mcap")
    size = file.stat().st_size
    with file.open("r+b") as opened:
        opened.truncate(random.randint(size // 2, size - 1))
    (bag / METADATA_FILE).unlink()
