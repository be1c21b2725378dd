# SPDX-License-Identifier: Apache-2.0
"""Random link models with all faults, for flights that depend on the configuration only."""

from __future__ import annotations

from random import Random

from flock_sim.physics import formation

FAULTS = {
    "delay": ["0", "1", "3"],
    "jitter": ["0", "2"],
    "drop": ["0", "0.3", "0.8"],
    "position_noise": ["0", "0.02"],
    "speed_noise": ["0", "0.001"],
    "position_quantum": ["0", "0.01"],
    "speed_quantum": ["0", "0.001"],
    "range": ["inf", "4"],
    "timeout": ["inf", "2"],
    "seed": ["1", "2"],
}


def random_links(random: Random, birds: int, coupling: str, members: int) -> tuple[str, ...]:
    """Return an entry for all links, and some for single links. Values may differ among members."""
    all_links = [
        (source, target)
        for target in range(1, birds + 1)
        for source in formation.neighbours(target, birds, coupling)
    ]
    single = random.sample(all_links, k=random.randint(0, len(all_links)))
    # If no link is exact, some steps have no exchange.
    models = ["exact", "hold", "linear"][random.randint(0, 1) :]
    others = [f"{i}->{j}={random_model(random, models, members)}" for i, j in single]
    return (random_model(random, models, members), *others)


def random_model(random: Random, models: list[str], members: int) -> str:
    model = random.choice(models)
    keys = [] if model == "exact" else [f"interval={random.choice([1, 2, 3, 7])}"]
    for key, values in FAULTS.items():
        if random.random() < 0.4:
            count = random.choice([1, members])
            keys.append(f"{key}={'/'.join(random.choice(values) for _ in range(count))}")
    return f"{model}:{','.join(keys)}" if keys else model
