# SPDX-License-Identifier: Apache-2.0
"""One value in which two runs differ, and the definition of a difference of values."""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from flock_sim.physics.arrays import FloatArray


@dataclass(frozen=True)
class Difference:
    """One value in which two runs differ. Fields that do not apply are None.

    Kind "missing" is a state that one run lacks; its values say for each run whether it has it.
    """

    kind: Literal["configuration", "wing", "state", "missing"]
    values: tuple[object, object]
    field: str | None = None
    topic: str | None = None
    bird: int | None = None
    step: int | None = None
    time: float | None = None
    member: int | None = None  # from 1

    @property
    def distance(self) -> float | None:
        """The absolute difference of two floats; None for other values."""
        first, second = self.values
        if isinstance(first, float) and isinstance(second, float):
            return float(distance(np.array(first), np.array(second)))
        return None

    @property
    def bits(self) -> list[str] | None:
        """The bits of two floats, in hexadecimal; None for other values."""
        floats = [value for value in self.values if isinstance(value, float)]
        return [struct.pack(">d", value).hex() for value in floats] if len(floats) == 2 else None

    def as_json(self) -> dict[str, object]:
        """Return plain values, with non-finite floats as text, and with the bits of floats."""
        return {
            **vars(self),
            "values": [_plain(value) for value in self.values],
            "difference": _plain(self.distance),
            "bits": self.bits,
        }


def distance(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return |first - second| elementwise: 0 between nans, inf between a nan and a number."""
    with np.errstate(invalid="ignore", over="ignore"):
        apart = np.abs(first - second)
    same = (first == second) | (np.isnan(first) & np.isnan(second))
    result: FloatArray = np.where(same, 0.0, np.where(np.isnan(apart), np.inf, apart))
    return result


def other_bits(first: FloatArray, second: FloatArray) -> npt.NDArray[np.bool_]:
    """Return where two arrays differ in any bit, such as -0.0 and 0.0, or two different nans."""
    bits = [np.ascontiguousarray(values).view(np.uint64) for values in (first, second)]
    differ: npt.NDArray[np.bool_] = bits[0] != bits[1]
    return differ


def _plain(value: object) -> object:
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return value
