# SPDX-License-Identifier: Apache-2.0
"""The keys of the text of a link, and the values that they may have."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

FORM = "[SOURCE->TARGET=]MODEL[:KEY=VALUE[/VALUE...],...]"
EXAMPLE = "hold:interval=10,delay=5"

SEPARATOR = "/"
"""Separator of the values of members. Commas separate keys."""

LONGEST = 10000
"""Longest delay and largest jitter, in steps: a bird remembers all messages in transit."""


@dataclass(frozen=True)
class LinkKey:
    """A key with numbers: its meaning, its unit ("1": none), and the values that it may have."""

    meaning: str
    unit: str
    told: str
    """The values in words."""
    holds: Callable[[float], bool]
    default: float = 0.0


def _whole(value: float) -> bool:
    return math.isfinite(value) and value == math.floor(value)


_STEPS = (
    "steps",
    f"a whole number of steps, 0..{LONGEST}",
    lambda v: _whole(v) and 0 <= v <= LONGEST,
)
_SIZE = "finite, 0 or more", lambda v: 0.0 <= v < math.inf

FAULTS = {
    "delay": LinkKey("delay", *_STEPS),
    "jitter": LinkKey("jitter", *_STEPS),
    "drop": LinkKey("probability of loss", "1", "a probability of [0, 1)", lambda v: 0 <= v < 1),
    "position_noise": LinkKey("noise of position", "b", *_SIZE),
    "speed_noise": LinkKey("noise of speed", "U_min", *_SIZE),
    "position_quantum": LinkKey("quantum of position", "b", *_SIZE),
    "speed_quantum": LinkKey("quantum of speed", "U_min", *_SIZE),
    "range": LinkKey("range", "b", "above 0", lambda v: v > 0.0, math.inf),
    "timeout": LinkKey(
        "timeout",
        "steps",
        "a whole number of steps, 0 or more, or inf",
        lambda v: v >= 0.0 and (_whole(v) or v == math.inf),
        math.inf,
    ),
    "seed": LinkKey(
        "seed", "1", "a whole number, 0..2^53", lambda v: _whole(v) and 0 <= v <= 2**53
    ),
}
"""The faults of a link, in the order of the rows of `Settings.faults`."""

DELAY, JITTER, DROP = 0, 1, 2
POSITION_NOISE, SPEED_NOISE, POSITION_QUANTUM, SPEED_QUANTUM = 3, 4, 5, 6
RANGE, TIMEOUT, SEED = 7, 8, 9

BOTH = {
    "noise": ("position_noise", "speed_noise"),
    "quantum": ("position_quantum", "speed_quantum"),
}
"""Keys that set two faults at once."""

INTERVAL = "interval"
NUMBERS = {
    INTERVAL: LinkKey(
        "interval of messages",
        "steps",
        "a whole number of steps, 1 or more",
        lambda v: _whole(v) and v >= 1,
        1.0,
    ),
    **FAULTS,
}
"""All keys that set one number."""

KEYS = (*NUMBERS, *BOTH)
