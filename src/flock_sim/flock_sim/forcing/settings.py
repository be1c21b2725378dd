# SPDX-License-Identifier: Apache-2.0
"""The settings of one forcing term, read from text.

As text it is [BIRD=]MODEL[:KEY=VALUE[/VALUE...],...], such as "gust:std=2e-5" for all birds of a
flock, or "7=sine:amplitude=1e-4/2e-4,period=400" for bird 7. MODEL is a built-in one, FILE.py:LAW,
or a law of an installed package.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

from flock_sim import model_text
from flock_sim.errors import FlockError
from flock_sim.forcing.models import ForcingModel
from flock_sim.forcing.registry import BUILT_IN, model_of, unknown
from flock_sim.model_text import SEPARATOR, items_of, members_of, values_of

if TYPE_CHECKING:
    from flock_sim.physics.arrays import FloatArray

FORM = f"[BIRD=]{model_text.FORM}"
EXAMPLE = "gust:std=2e-5,seed=7"

_BIRD = re.compile(r"\s*([+-]?\d+)=(.*)", re.DOTALL)
_FILE_LAW = re.compile(r"(.+?\.py:[^:]*)(?::(.*))?", re.DOTALL)


@dataclass(frozen=True)
class Settings:
    """One forcing term: its text, its bird (None: all birds), its model, and its keys as text."""

    text: str
    bird: int | None
    name: str
    items: tuple[tuple[str, str], ...]

    @property
    def called(self) -> str:
        """How errors name it."""
        return f"forcing {self.text!r}"

    @property
    def members(self) -> int:
        """Number of members for which values are given."""
        return members_of(self.called, [(key, text.split(SEPARATOR)) for key, text in self.items])

    @cached_property
    def model(self) -> ForcingModel:
        """Its model. Raises FlockError if this process does not have it."""
        model = model_of(self.name)
        if model is None:
            raise unknown(self.called, self.name)
        return model

    @cached_property
    def given(self) -> Mapping[str, list[float]]:
        """The values of the keys in the text. Raises FlockError on a bad one."""
        given = values_of(self.called, self.items, self.model.keys)
        self._check_given(given)
        return given

    def values(self, members: int) -> dict[str, FloatArray | None]:
        """Return the values of all keys, each of shape (members,); None: no value, no default."""
        import numpy as np

        return {
            key: None
            if (value := self.given.get(key, bounds.default)) is None
            else np.broadcast_to(np.array(value, dtype=np.float64), (members,)).copy()
            for key, bounds in self.model.keys.items()
        }

    def check(self) -> None:
        """Raise FlockError if a value is bad, or this process does not have the model."""
        self.given  # noqa: B018  (read once)

    def _check_given(self, given: Mapping[str, object]) -> None:
        for key in self.model.required:
            if key not in given:
                raise FlockError(f"{self.called}: {key} is missing; give {key}=VALUE")


def read(entry: str) -> Settings:
    """Return the settings in `entry`. Raises FlockError if it does not have their form.

    An own law is not loaded, and its keys are not checked. Those of built-in models are.
    """
    match = _BIRD.fullmatch(entry)
    bird, what = (int(match[1]), match[2]) if match else (None, entry)
    law = _FILE_LAW.fullmatch(what)
    name, rest = (law[1], law[2] or "") if law else (what.partition(":")[0], what.partition(":")[2])
    settings = Settings(entry, bird, name, tuple(items_of(rest)))
    if not name:
        raise FlockError(f"forcing {entry!r}: must be {FORM} such as {EXAMPLE}")
    settings.members  # noqa: B018  (the number of values of each key is checked)
    if name in BUILT_IN:
        settings.check()
    return settings
