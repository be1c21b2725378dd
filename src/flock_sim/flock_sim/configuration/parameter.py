# SPDX-License-Identifier: Apache-2.0
"""A parameter of nodes: its default, its range, its meaning, and the nodes that declare it."""

from __future__ import annotations

import operator
from dataclasses import dataclass
from typing import Any

from flock_sim.console.arguments import (
    positive_number,
    whole_number,
)
from flock_sim.errors import FlockError, nearest
from flock_sim.outside.printing import shown


@dataclass(frozen=True)
class Parameter:
    """A parameter of nodes. Its values have the type of its default."""

    default: Any
    meaning: str
    least: int = 1
    """The least whole number. A real number must be above 0, or with 0 here at least 0."""
    most: int | None = None
    """The largest whole number."""
    up_to_birds: bool = False
    """Whether the range ends at the number of birds. Then the node checks it."""
    choices: tuple[str, ...] = ()
    """The accepted words; none: any text."""
    nodes: tuple[str, ...] = ()
    """The nodes that declare it."""

    def checked(self, name: str, value: Any) -> Any:
        """Return `value`, or the number that this text contains.

        Raises FlockError, with `name`, if it is out of range.
        """
        if self.choices and value not in self.choices:
            raise FlockError(f"{name} {value!r}: {nearest(value, self.choices)}")
        if isinstance(self.default, float) and (value or self.least):
            return positive_number(name, str(value))
        if type(self.default) is int and not self.up_to_birds:
            return whole_number(name, str(value), self.least, self.most)
        return value

    def typed(self, name: str, value: Any) -> Any:
        """Return `value` if it has the right type; a whole number may replace a real one.

        Raises FlockError, with `name`, if it has another type.
        """
        default = self.default
        if isinstance(default, list):
            try:
                return [operator.index(item) for item in value]
            except TypeError:
                raise FlockError(f"{name} = {value!r}: must be a list such as [1, 2]") from None
        if isinstance(default, float) and type(value) is int:
            try:
                return float(value)
            except OverflowError:
                raise FlockError(
                    f"{name} = {shown(str(value))}: must be a number that a float holds"
                ) from None
        if type(value) is not type(default):
            raise FlockError(
                f"{name} = {value!r}: must be a {type(default).__name__} such as {default!r}"
            )
        return value
