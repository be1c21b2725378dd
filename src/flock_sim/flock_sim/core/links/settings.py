# SPDX-License-Identifier: Apache-2.0
"""How one link is set: its model and its faults, read from text.

As text a link is [SOURCE->TARGET=]MODEL[:KEY=VALUE[/VALUE...],...], such as "hold:interval=10" for
all links of a flock, or "3->4=linear:delay=2,drop=0.1/0.3" for what bird 4 knows of bird 3; several
values are those of the members.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from flock_sim.core.kernel import FloatArray
from flock_sim.core.links.registry import MODELS
from flock_sim.core.runge_kutta import STAGES
from flock_sim.core.spelling import nearest
from flock_sim.errors import FlockError

FORM = "[SOURCE->TARGET=]MODEL[:KEY=VALUE[/VALUE...],...]"
EXAMPLE = "hold:interval=10,delay=5"

SEPARATOR = "/"
"""Between the values of members: commas are between keys."""

LONGEST = 10000
"""Most steps of delay, and of jitter: a bird remembers what is on its way."""


@dataclass(frozen=True)
class Range:
    """The values that a key may have."""

    told: str
    holds: Callable[[float], bool]
    default: float = 0.0


def _whole(value: float) -> bool:
    return math.isfinite(value) and value == math.floor(value)


_STEPS = Range(f"a whole number of steps, 0..{LONGEST}", lambda v: _whole(v) and 0 <= v <= LONGEST)
_SIZE = Range("finite, 0 or more", lambda v: 0.0 <= v < math.inf)

FAULTS = {
    "delay": _STEPS,
    "jitter": _STEPS,
    "drop": Range("a probability of [0, 1)", lambda v: 0.0 <= v < 1.0),
    "position_noise": _SIZE,
    "speed_noise": _SIZE,
    "position_quantum": _SIZE,
    "speed_quantum": _SIZE,
    "range": Range("above 0", lambda v: v > 0.0, math.inf),
    "timeout": Range(
        "a whole number of steps, 0 or more, or inf",
        lambda v: v >= 0.0 and (_whole(v) or v == math.inf),
        math.inf,
    ),
    "seed": Range("a whole number, 0..2^53", lambda v: _whole(v) and 0 <= v <= 2**53),
}
"""What can be wrong with a link, in the order of the rows of `Settings.faults`."""

DELAY, JITTER, DROP = 0, 1, 2
POSITION_NOISE, SPEED_NOISE, POSITION_QUANTUM, SPEED_QUANTUM = 3, 4, 5, 6
RANGE, TIMEOUT, SEED = 7, 8, 9

BOTH = {
    "noise": ("position_noise", "speed_noise"),
    "quantum": ("position_quantum", "speed_quantum"),
}
"""Keys that set two at once."""

INTERVAL = "interval"
_INTERVAL = Range("a whole number of steps, 1 or more", lambda v: _whole(v) and v >= 1, 1.0)

KEYS = (INTERVAL, *FAULTS, *BOTH)

# A message on its way: when it was sent (-1: never), from which step on it can be used, and what
# it says: position, speed and circulation. Of the latest that has arrived there is, in place of its
# arrival, the rate at which the circulation has changed since the one before.
SENT, ARRIVAL, POSITION, SPEED, CIRCULATION = range(5)
RATE = ARRIVAL
FIELDS = 5


@dataclass(frozen=True)
class Settings:
    """How one link is set."""

    text: str
    model: int
    """The place of its model in MODELS."""
    interval: int
    faults: FloatArray
    """The rows are those of FAULTS, shape (10, members), or (10, 1) where all members are alike."""

    @property
    def members(self) -> int:
        """For how many members values are given."""
        return int(self.faults.shape[1])

    @property
    def every_stage(self) -> bool:
        """Whether the source sends at all stages."""
        return MODELS[self.model].every_stage

    @property
    def faultless(self) -> bool:
        """Whether nothing is late, lost or altered, by what is set."""
        defaults = [bounds.default for bounds in FAULTS.values()][:SEED]
        return bool(np.all(defaults == self.faults[:SEED].T))

    @property
    def plain(self) -> bool:
        """Whether the target knows at every stage just what the source says at it."""
        return self.every_stage and self.faultless

    @property
    def rows(self) -> int:
        """How many stages of a step are remembered; none where the link is plain."""
        if self.plain:
            return 0
        return STAGES if self.every_stage else 1

    @property
    def slots(self) -> int:
        """How many exchanges can be on their way at once."""
        return int(np.max(self.faults[DELAY] + self.faults[JITTER])) // self.interval + 1

    @property
    def vectors(self) -> int:
        """How many vectors of one number a member the target remembers: what it has, and more."""
        return (1 + self.slots) * self.rows * FIELDS


PLAIN = Settings(
    "exact", 0, 1, np.array([[bounds.default] for bounds in FAULTS.values()], dtype=np.float64)
)


def read(entry: str) -> tuple[tuple[int, int] | None, Settings]:
    """Return the link that `entry` sets, None for all, and how. Raises FlockError with the fix."""
    called = f"link {entry!r}"
    link, what = _link(entry)
    name, _, rest = what.partition(":")
    names = [model.name for model in MODELS]
    if name not in names:
        raise FlockError(f"{called}: unknown model {name!r}: {nearest(name, names)}")
    values = _values(called, rest)
    model = names.index(name)
    interval = values.pop(INTERVAL, [1.0])
    if len(set(interval)) > 1:
        raise FlockError(f"{called}: members share messages; give one interval to all of them")
    if MODELS[model].every_stage and interval[0] > 1:
        raise FlockError(
            f"{called}: {name} needs an exchange at every stage; leave interval out, or take "
            f"{' or '.join(model.name for model in MODELS if not model.every_stage)}"
        )
    members = _members(called, values)
    faults = np.empty((len(FAULTS), members))
    for row, (key, bounds) in enumerate(FAULTS.items()):
        faults[row] = values.get(key, bounds.default)
    return link, Settings(entry, model, int(interval[0]), faults)


def _link(entry: str) -> tuple[tuple[int, int] | None, str]:
    """Return (source, target), or None where all links are meant, and what is said of it."""
    birds, equals, what = entry.partition("=")
    source, arrow, target = birds.partition("->")
    if not arrow or ":" in birds:
        return None, entry
    try:
        if equals:
            return (int(source), int(target)), what
    except ValueError:
        pass
    raise FlockError(f"link {entry!r}: must be {FORM} such as {EXAMPLE} or 3->4=linear:delay=2")


def _values(called: str, text: str) -> dict[str, list[float]]:
    """Return the values of each key in "KEY=VALUE[/VALUE...],..."."""
    values: dict[str, list[float]] = {}
    for item in text.split(",") if text else []:
        key, _, given = item.partition("=")
        if key not in KEYS:
            raise FlockError(f"{called}: unknown key {key!r}: {nearest(key, KEYS)}")
        for single in BOTH.get(key, (key,)):
            if single in values:
                raise FlockError(f"{called}: {single} is given twice; leave one out")
            bounds = _INTERVAL if single == INTERVAL else FAULTS[single]
            values[single] = [_number(called, key, word, bounds) for word in given.split(SEPARATOR)]
    return values


def _number(called: str, key: str, word: str, bounds: Range) -> float:
    try:
        value = float(word)
    except ValueError:
        value = math.nan
    if not bounds.holds(value):
        raise FlockError(f"{called}: {key}={word} must be {bounds.told}")
    return value


def _members(called: str, values: dict[str, list[float]]) -> int:
    """Return for how many members `values` are."""
    members = max((len(given) for given in values.values()), default=1)
    for key, given in values.items():
        if len(given) not in (1, members):
            longest = next(k for k, v in values.items() if len(v) == members)
            raise FlockError(
                f"{called}: {key} has {len(given)} values and {longest} {members}: give 1 or "
                f"{members} of each, between {SEPARATOR!r}"
            )
    return members
