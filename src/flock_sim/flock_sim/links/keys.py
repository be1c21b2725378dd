# SPDX-License-Identifier: Apache-2.0
"""The keys of the text of a link, and the values that they may have."""

from __future__ import annotations

import math

from flock_sim import model_text
from flock_sim.model_text import NumberKey, whole

FORM = f"[SOURCE:TARGET=]{model_text.FORM}"
EXAMPLE = "hold:interval=10,delay=5"

LONGEST = 10000
"""Longest delay and largest jitter, in steps: a bird remembers all messages in transit."""


_STEPS = (
    "steps",
    f"a whole number of steps, 0..{LONGEST}",
    lambda v: whole(v) and 0 <= v <= LONGEST,
)
_SIZE = "finite, 0 or more", lambda v: 0.0 <= v < math.inf

FAULTS = {
    "delay": NumberKey("delay", *_STEPS),
    "jitter": NumberKey("jitter", *_STEPS),
    "drop": NumberKey("probability of loss", "1", "a probability of [0, 1)", lambda v: 0 <= v < 1),
    "position_noise": NumberKey("noise of position", "b", *_SIZE),
    "speed_noise": NumberKey("noise of speed", "U_min", *_SIZE),
    "position_quantum": NumberKey("quantum of position", "b", *_SIZE),
    "speed_quantum": NumberKey("quantum of speed", "U_min", *_SIZE),
    "range": NumberKey("range", "b", "above 0", lambda v: v > 0.0, math.inf),
    "timeout": NumberKey(
        "timeout",
        "steps",
        "a whole number of steps, 0 or more, or inf",
        lambda v: v >= 0.0 and (whole(v) or v == math.inf),
        math.inf,
    ),
    "seed": model_text.SEED,
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
    INTERVAL: NumberKey(
        "interval of messages",
        "steps",
        "a whole number of steps, 1 or more",
        lambda v: whole(v) and v >= 1,
        1.0,
    ),
    **FAULTS,
}
"""All keys that set one number."""

KEYS = (*NUMBERS, *BOTH)

SYNONYMS = {
    **dict.fromkeys(("loss", "lost", "packet_loss", "drop_rate"), "drop"),
    **dict.fromkeys(("latency", "lag"), "delay"),
    **dict.fromkeys(("period", "every"), "interval"),
    **dict.fromkeys(("resolution", "rounding"), "quantum"),
}
"""Keys for other words of the same meaning."""


def birds_of(text: str) -> tuple[int, int] | None:
    """Return source and target; None if `text` is not SOURCE->TARGET or SOURCE:TARGET."""
    source, _, target = text.partition("->" if "->" in text else ":")
    try:
        return int(source), int(target)
    except ValueError:
        return None


def with_arrow(entry: str) -> str:
    """Return the text of a link as configurations have it: 3->4=MODEL also for 3:4=MODEL."""
    birds, _, what = entry.partition("=")
    link = birds_of(birds)
    return entry if "->" in birds or not link else f"{link[0]}->{link[1]}={what}"
