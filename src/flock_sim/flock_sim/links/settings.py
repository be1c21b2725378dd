# SPDX-License-Identifier: Apache-2.0
"""The settings of one link: its model and its faults, read from text.

As text a link is [SOURCE->TARGET=]MODEL[:KEY=VALUE[/VALUE...],...], such as "hold:interval=10" for
all links of a flock, or "3->4=linear:delay=2,drop=0.1/0.3" for what bird 4 knows of bird 3. Several
values of a key are those of the members. SOURCE:TARGET is read, too: a shell leaves it as it is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flock_sim.errors import FlockError, nearest
from flock_sim.links import keys
from flock_sim.links.keys import (
    BOTH,
    DELAY,
    EXAMPLE,
    FAULTS,
    FORM,
    INTERVAL,
    JITTER,
    NUMBERS,
    SEED,
    SYNONYMS,
)
from flock_sim.links.registry import MODELS
from flock_sim.model_text import items_of, members_of, values_of
from flock_sim.physics.arrays import FloatArray
from flock_sim.physics.runge_kutta import STAGES

# Fields of a message in transit: the step at which it was sent (-1: never), the first step at which
# it can be used, and its values: position, speed and circulation. For the latest message that has
# arrived, the rate of change of the circulation since the message before replaces its arrival.
SENT, ARRIVAL, POSITION, SPEED, CIRCULATION = range(5)
RATE = ARRIVAL
FIELDS = 5


@dataclass(frozen=True)
class Settings:
    """The settings of one link."""

    text: str
    model: int
    """The index of its model in MODELS."""
    interval: int
    faults: FloatArray
    """The rows are those of FAULTS, shape (10, members), or (10, 1) if all members are alike."""

    @property
    def members(self) -> int:
        """Number of members for which values are given."""
        return int(self.faults.shape[1])

    @property
    def every_stage(self) -> bool:
        """Whether the source sends at all stages."""
        return MODELS[self.model].every_stage

    @property
    def faultless(self) -> bool:
        """Whether the settings make no message late, lost or altered."""
        defaults = [bounds.default for bounds in FAULTS.values()][:SEED]
        return bool(np.all(defaults == self.faults[:SEED].T))

    @property
    def plain(self) -> bool:
        """Whether the target has, at every stage, the exact values of the source at this stage."""
        return self.every_stage and self.faultless

    @property
    def rows(self) -> int:
        """Number of stages of a step that are remembered; 0 if the link is plain."""
        if self.plain:
            return 0
        return STAGES if self.every_stage else 1

    @property
    def slots(self) -> int:
        """Number of exchanges that can be in transit at once."""
        return int(np.max(self.faults[DELAY] + self.faults[JITTER])) // self.interval + 1

    @property
    def vectors(self) -> int:
        """Number of vectors that the target remembers, each with one number per member.

        They hold the latest message and those in transit.
        """
        return (1 + self.slots) * self.rows * FIELDS


PLAIN = Settings(
    "exact", 0, 1, np.array([[bounds.default] for bounds in FAULTS.values()], dtype=np.float64)
)


def read(entry: str) -> tuple[tuple[int, int] | None, Settings]:
    """Return the link that `entry` sets (None: all links) and its settings; raises FlockError."""
    called = f"link {entry!r}"
    link, name, items = parted(entry)
    names = [model.name for model in MODELS]
    if name not in names:
        raise FlockError(f"{called}: unknown model {name!r}: {nearest(name, names)}")
    values = values_of(called, items, NUMBERS, BOTH, SYNONYMS)
    model = names.index(name)
    interval = values.pop(INTERVAL, [1.0])
    if len(set(interval)) > 1:
        raise FlockError(f"{called}: members share messages; give one interval to all of them")
    if MODELS[model].every_stage and interval[0] > 1:
        raise FlockError(
            f"{called}: {name} needs an exchange at every stage; leave interval out, or take "
            f"{' or '.join(model.name for model in MODELS if not model.every_stage)}"
        )
    members = members_of(called, values.items())
    faults = np.empty((len(FAULTS), members))
    for row, (key, bounds) in enumerate(FAULTS.items()):
        faults[row] = values.get(key, bounds.default)
    return link, Settings(entry, model, int(interval[0]), faults)


def parted(entry: str) -> tuple[tuple[int, int] | None, str, list[tuple[str, str]]]:
    """Return the parts of the text of a link: its birds, its model, and each key with its values.

    The birds are (source, target), or None if `entry` is for all links. Raises FlockError if
    `entry` has neither form.
    """
    birds, equals, what = entry.partition("=")
    link = keys.birds_of(birds) if equals else None
    if link is None and "->" in birds and ":" not in birds:
        raise FlockError(
            f"link {entry!r}: must be {FORM} such as {EXAMPLE} or 3:4=linear:delay=2 (3->4=... is "
            "the same)"
        )
    model, _, rest = (what if link else entry).partition(":")
    return link, model, items_of(rest)
