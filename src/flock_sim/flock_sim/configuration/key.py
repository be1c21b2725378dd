# SPDX-License-Identifier: Apache-2.0
"""A key of the configuration: its default, its meaning, and the values that it may have."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, ClassVar

from flock_sim.errors import FlockError, nearest
from flock_sim.outside.printing import shown


@dataclass(frozen=True)
class Key:
    """A key of the configuration. Whole numbers are 1 or more, other numbers finite and above 0."""

    default: int | float | str | tuple[str, ...]
    """The default. Its type is that of all values."""
    meaning: str
    unit: str = "1"
    """Unit of a number, "1" if it has none."""
    symbol: str = ""
    """Symbol in the paper."""
    note: str = ""
    least: ClassVar[int] = 1
    """Least whole number; other numbers are above 0."""
    most: int = 2**53
    """Largest whole number."""
    choices: tuple[str, ...] = ()
    """The values of a text."""
    form: str = ""
    """Form of an entry of a list."""
    example: str = ""
    """Example of an entry of a list."""

    @property
    def text(self) -> str:
        """The meaning with symbol, unit and note."""
        symbol = f" ({self.symbol})" if self.symbol else ""
        unit = "" if self.unit == "1" else f", in {self.unit}"
        note = f": {self.note}" if self.note else ""
        return self.meaning + symbol + unit + note

    def read(self, name: str, value: Any) -> Any:
        """Return a value in the type of the key. It may be text that can be read as this type.

        Raises FlockError, which gives the `name` of the key, if it can't be read.
        """
        if isinstance(self.default, tuple):
            if isinstance(value, str) or not isinstance(value, Iterable):
                raise FlockError(f'{name} = {value!r}: must be a list such as ["{self.example}"]')
            return tuple(_text(name, item) for item in value if item != "")
        if isinstance(self.default, str):
            return _text(name, value)
        try:
            number = number_of(value)
        except ValueError:
            raise FlockError(f"{name} = {shown(repr(value))}: must be a number") from None
        if isinstance(self.default, float):
            return number
        if not math.isfinite(number) or number != math.floor(number):
            raise FlockError(f"{name} = {shown(str(value))}: must be a whole number")
        return int(number)

    def check(self, name: str, value: Any) -> None:
        """Raise FlockError, which gives the `name` of the key, if the value is out of range."""
        if isinstance(self.default, int):
            if value < 1:
                raise FlockError(f"{name} = {told(value)}: must be 1 or more")
            if value > self.most:
                raise FlockError(f"{name} = {told(value)}: must be {self.most} or less")
        elif isinstance(self.default, float):
            if not (math.isfinite(value) and value > 0.0):
                raise FlockError(f"{name} = {value:g}: must be finite and above 0")
        elif self.choices and value not in self.choices:
            raise FlockError(f"{name} = {value!r}: {nearest(value, self.choices)}")


def number_of(value: Any) -> float:
    """Return a number, or text that can be read as one. Raises ValueError for anything else."""
    if isinstance(value, int | float | str) and not isinstance(value, bool):
        try:
            return float(value)
        except OverflowError:
            pass
    raise ValueError("not a number")


def told(value: float) -> str:
    """Return the shortest text of a number that reads as this number."""
    short = f"{value:g}"
    return short if float(short) == value else repr(value)


def _text(name: str, value: Any) -> str:
    if not isinstance(value, str):
        raise FlockError(f"{name} = {value!r}: must be text")
    return value
