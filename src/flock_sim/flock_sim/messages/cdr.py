# SPDX-License-Identifier: Apache-2.0
"""CDR, the bytes of messages: the types of fields, and how messages are encoded and decoded."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Iterator
from dataclasses import fields
from typing import Annotated, Any, ClassVar, Self, get_type_hints

import numpy as np

from flock_sim.physics.arrays import FloatArray

ENCAPSULATION = b"\x00\x01\x00\x00"  # plain CDR, little-endian

# The types of fields. Each has a kind: a `struct` format character, "text", or "numbers".
Int32 = Annotated[int, "i"]
Int64 = Annotated[int, "q"]
UInt8 = Annotated[int, "B"]
UInt32 = Annotated[int, "I"]
UInt64 = Annotated[int, "Q"]
Float64 = Annotated[float, "d"]
Text = Annotated[str, "text"]
Numbers = Annotated[FloatArray, "numbers"]  # a float64 sequence

_FIRST = {"text": "I", "numbers": "I"}  # sequences begin with their length


class Message:
    """A message: a dataclass whose fields have the types above, in the order of the bytes."""

    TYPE: ClassVar[str]
    KINDS: ClassVar[tuple[str, ...]]
    """The kinds of the fields, in order."""

    def __init_subclass__(cls) -> None:
        hints = get_type_hints(cls, include_extras=True).values()
        cls.KINDS = tuple(hint.__metadata__[0] for hint in hints if hasattr(hint, "__metadata__"))

    def encode(self) -> bytes:
        """Return the message as CDR, encapsulation header included."""
        data = bytearray(ENCAPSULATION)
        for _, kind, value in self._fields():
            put(data, kind, value)
        return bytes(data)

    def place(self, name: str) -> int:
        """Return the offset of the field `name` in the encoded message, in bytes."""
        data = bytearray(ENCAPSULATION)
        for field, kind, value in self._fields():
            if field == name:
                align(data, struct.calcsize(_FIRST.get(kind, kind)))
                return len(data)
            put(data, kind, value)
        raise KeyError(name)

    @classmethod
    def decode(cls, data: bytes) -> Self:
        """Return the message in `data`. Raises ValueError if it does not hold one."""
        return cls(*cls.values_in(data, cls.KINDS))

    @classmethod
    def values_in(cls, data: bytes, kinds: Iterable[str]) -> list[Any]:
        """Return the values of fields of `kinds`. Raises ValueError if `data` has others."""
        if data[:4] != ENCAPSULATION:
            raise ValueError(f"{cls.TYPE}: not little-endian CDR")
        values: list[Any] = []
        at = 4
        try:
            for kind in kinds:
                first = _FIRST.get(kind, kind)
                size = struct.calcsize(first)
                at += (4 - at) % size
                (value,) = struct.unpack_from("<" + first, data, at)
                at += size
                if kind == "text":
                    if at + value > len(data):
                        raise ValueError("text cut short")
                    values.append(str(data[at : at + value - 1], "utf-8"))
                    at += value
                elif kind == "numbers":
                    at += (4 - at) % 8 if value else 0
                    values.append(np.frombuffer(data, dtype="<f8", count=value, offset=at))
                    at += 8 * value
                else:
                    values.append(value)
        except (struct.error, ValueError) as error:
            raise ValueError(f"{cls.TYPE}: {len(data)} bytes are too few ({error})") from None
        return values

    def _fields(self) -> Iterator[tuple[str, str, Any]]:
        """Yield name, kind and value of each field."""
        for field, kind in zip(fields(self), self.KINDS, strict=True):  # type: ignore[arg-type]
            yield field.name, kind, getattr(self, field.name)


def align(data: bytearray, size: int) -> None:
    """Pad `data`, CDR with its encapsulation header, so that a value of `size` bytes can follow."""
    data += bytes((4 - len(data)) % size)


def put(data: bytearray, kind: str, value: Any) -> None:
    """Append `value` as CDR; `kind` is a `struct` format character, "text", or "numbers"."""
    if kind == "text":
        text = str(value).encode() + b"\0"
        put(data, "I", len(text))
        data += text
    elif kind == "numbers":
        put(data, "I", len(value))
        if len(value):
            align(data, 8)
            data += np.ascontiguousarray(value, dtype="<f8").tobytes()
    else:
        align(data, struct.calcsize(kind))
        data += struct.pack("<" + kind, value)


def fixed_layout(*kinds: str) -> struct.Struct:
    """Return the layout of fields of fixed size, each aligned to its own size."""
    layout = "<"
    for kind in kinds:
        layout += f"{-struct.calcsize(layout) % struct.calcsize(kind)}x{kind}"
    return struct.Struct(layout)


def step_at(kind: type[Message], data: bytes, at: int) -> int:
    """Return the step at offset `at` of an encoded message. Raises ValueError if it is short."""
    if len(data) < at + 8:
        raise ValueError(f"{kind.TYPE}: {len(data)} bytes are too few")
    return int.from_bytes(data[at : at + 8], "little")
