# SPDX-License-Identifier: Apache-2.0
"""Random flights over all options of a configuration."""

from __future__ import annotations

from dataclasses import replace
from random import Random

from flock_sim.configuration.flock_configuration import FlockConfiguration
from support.random_forcing import random_forcing
from support.random_links import random_links

BODIES = {
    "body_mass": (2.5, 5.1),
    "wing_span": (1.3, 1.7),
    "air_density": (0.9, 1.3),
    "cruise_speed": (18.2, 19.4),
    "oswald_efficiency": (0.7, 0.95),
    "zero_lift_drag": (0.02, 0.03),
    "aspect_ratio": (7.0, 11.0),
}
"""Keys of the standard bird, and the ranges from which their values are drawn."""


def random_flight(random: Random, *, members: int = 0) -> FlockConfiguration:
    """Return a flight of a few steps. With `members` 0, it has one to three members."""
    birds = random.randint(1, 5)
    members = members or random.randint(1, 3)
    steps = random.randint(1, 40)
    dt = random.choice([0.3, 0.5, 1.0, 2.0])
    coupling = random.choice(["nearest", "all"])
    body = {
        key: round(random.uniform(*span), 3)
        for key, span in BODIES.items()
        if random.random() < 0.2
    }
    flight = FlockConfiguration(
        birds=birds,
        coupling=coupling,
        dt=dt,
        t_max=dt * steps,
        record_every=random.randint(1, 7),
        span_ratios=_span_ratios(random, birds, members),
        **body,
    )
    links = random_links(random, birds, coupling, members) if random.random() < 0.5 else ()
    flight = replace(flight, links=links, perturbations=_pushes(random, flight))
    if random.random() < 0.5:
        flight = replace(flight, forcing=random_forcing(random, birds, members))
        flight.load_laws()
    return flight


def _span_ratios(random: Random, birds: int, members: int) -> tuple[str, ...]:
    """Return span ratios of some birds, with values for all members. Several need one bird."""
    differ = random.sample(range(1, birds + 1), k=random.randint(int(members > 1), birds))
    return tuple(
        f"{bird}=" + ",".join(f"{random.uniform(0.9, 1.1):.3f}" for _ in range(members))
        for bird in differ
    )


def _pushes(random: Random, flight: FlockConfiguration) -> tuple[str, ...]:
    """Return perturbations at the first, the last, a recorded and another step, in any order."""
    steps, every = flight.steps, flight.record_every
    recorded = every * random.randint(0, steps // every)
    moments = [0, steps, recorded, random.randint(0, steps)]
    pushes = []
    for _ in range(random.randint(0, 4)):
        bird = str(random.randint(1, flight.birds))
        if random.random() < 0.5:
            bird += f":{random.randint(1, flight.members)}"
        change = f"{random.uniform(-0.3, 0.3):.4f}"
        if random.random() < 0.5:
            change += f",{random.uniform(-0.01, 0.01):.5f}"
        pushes.append(f"{bird}@{random.choice(moments)}={change}")
    return tuple(pushes)
