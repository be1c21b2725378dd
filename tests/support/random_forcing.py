# SPDX-License-Identifier: Apache-2.0
"""Random forcing with all models, and with laws of one's own."""

from __future__ import annotations

from pathlib import Path
from random import Random

LAWS = Path(__file__).with_name("laws.py")

MODELS = {
    "constant": {"force": ["1e-4", "-3e-4", "0"]},
    "sine": {"amplitude": ["1e-3", "0"], "period": ["7", "400"], "phase": ["0", "0.3"]},
    "keeper": {"gap": ["0.8", "-0.4"], "stiffness": ["0.02", "0.001"], "damping": ["0.1", "0"]},
    "gust": {"std": ["1e-3", "2e-5"], "time": ["20", "0.1"], "seed": ["0", "1", "7"]},
    f"{LAWS}:lean": {"gap": ["0.5", "0.2"], "stiffness": ["2e-3"], "period": ["10", "40"]},
    f"{LAWS}:cruise": {"speed": ["1.01", "1.05"], "shake": ["0", "1e-3"], "seed": ["0", "3"]},
}
"""Each model with values of its keys."""

REQUIRED = ("force", "amplitude", "period", "gap", "stiffness", "std")


def random_forcing(random: Random, birds: int, members: int) -> tuple[str, ...]:
    """Return one to three entries, for all birds or one. Values may differ among members."""
    return tuple(random_term(random, birds, members) for _ in range(random.randint(1, 3)))


def random_term(random: Random, birds: int, members: int) -> str:
    name = random.choice(list(MODELS))
    keys = []
    for key, values in MODELS[name].items():
        if key in REQUIRED or random.random() < 0.5:
            count = random.choice([1, members])
            keys.append(f"{key}={'/'.join(random.choice(values) for _ in range(count))}")
    whose = f"{random.randint(1, birds)}=" if random.random() < 0.5 else ""
    return f"{whose}{name}:{','.join(keys)}" if keys else f"{whose}{name}"
