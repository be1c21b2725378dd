# SPDX-License-Identifier: Apache-2.0
"""Random messages and mutations of genuine ones, which know the layout of each message."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable, Sequence
from dataclasses import fields
from random import Random
from typing import Any, NamedTuple

import numpy as np

from flock_sim.messages import types
from flock_sim.messages.cdr import ENCAPSULATION, Message, align, put
from support.random_text_files import ENTRIES, VALUES

KINDS: dict[str, type[Message]] = {
    kind.TYPE: kind
    for kind in (
        *(types.Wing, types.Stage, types.State, types.Grant, types.Progress, types.Memory),
        *(types.Ages, types.Checkpoint, types.Push, types.Time),
    )
}
"""The messages that nodes receive, by type."""

OTHER_ENCAPSULATIONS = [
    *(bytes([0, low, 0, 0]) for low in (0, 2, 3, 6, 7, 8, 9, 10, 11, 12, 255)),
    *(b"\x01\x00\x00\x00", b"\xff\xff\xff\xff", b"\x80\x01\x00\x00"),
]
"""Big-endian CDR, parameter lists, XCDR2, and none that exists."""

TOO_LONG = (2**16, 2**31 - 1, 2**31, 2**32 - 8, 2**32 - 1)
"""Lengths that no message of these tests has."""

REALS = (
    *(np.nan, -np.nan, np.inf, -np.inf, 0.0, -0.0, 5e-324, -2.2e-308, 1e308, -1e308, 1e200),
    *(1.0, -1.0, 0.1, 1e-300, 1e9, 2.0**63),
)
INTEGERS = (
    *(0, 1, -1, 2, 5, 10, 255, 2**20, 2**31 - 1, 2**31, 2**32 - 1),
    *(2**53 + 1, 2**62, 2**63 - 1, 2**63, 2**64 - 1),
)
EPOCHS_AWAY = (1, -1, 2, 1000, 2**20, 2**20 + 1, 2**31 - 1, 2**31, -(2**20))
TEXTS = (
    *("", "\0", "bird_01", "bird_02", "bird_99", "recorder", "clock", "\x1b[2J\r\n", "\u202e\x9b"),
    *("x" * 100_000, "[" * 100_000, '{"a":' * 1000, "{}", "[]", "null", "NaN", "1e999"),
    *("9" * 10_000, '{"a":1e999}', '{"birds":"\x1b]0;x\x07"}', "a b"),
    *("1@10=0.1,0.1", "1:1@10=nan,0", "9@1=1,1"),
)  # fmt: skip
SIZES = {"B": 1, "i": 4, "I": 4, "q": 8, "Q": 8, "d": 8}


class Place(NamedTuple):
    """The place of a field in an encoded message."""

    kind: str
    at: int
    """Offset of a number, or of the length of a text or sequence, in bytes."""
    first: int
    """Offset of the first byte after that length."""
    size: int
    """Size of the text or the numbers, in bytes."""


class Sample(NamedTuple):
    """A genuine message, and the places of its fields."""

    message: Message
    data: bytes
    places: list[Place]


def sample_of(message: Message) -> Sample:
    """Return a genuine message with its layout."""
    data, places = bytearray(ENCAPSULATION), []
    for _, kind, value in message._fields():
        align(data, SIZES.get(kind, 4))
        at = len(data)
        put(data, kind, value)
        size = 8 * len(value) if kind == "numbers" else len(data) - at - 4 if kind == "text" else 0
        places.append(Place(kind, at, len(data) - size, size))
    return Sample(message, bytes(data), places)


class Mutator:
    """Makes messages for one topic out of the last genuine ones on it.

    `run_id` is the run of the flight; None: messages of this topic belong to no run.
    """

    def __init__(
        self,
        random: Random,
        kind: type[Message],
        run_id: int | None,
        strangers: Sequence[Message] = (),
    ) -> None:
        """Begin without genuine messages. `strangers` are well-formed random messages."""
        self._random = random
        self._kind = kind
        self._run_id = run_id
        self._samples: list[Sample] = []
        self._strangers = [sample_of(message) for message in strangers]
        names = [each.name for each in fields(kind)]  # type: ignore[arg-type]
        self._run = names.index("run_id") if run_id is not None else None
        self._epoch = names.index("epoch") if "epoch" in names else None
        broken = [self._noise, self._cut, self._encapsulated, self._too_long]
        self._invalid: list[Callable[[], bytes]] = [
            *broken,
            *([self._of_another_run] * 3 if self._run is not None else []),
            *([self._not_utf8] if "text" in kind.KINDS else []),
        ]
        self._any: list[Callable[[], bytes]] = [
            *self._invalid,
            *[self._flipped] * 2,
            *[self._odd_value] * 6,
            *(self._longer, self._resized, self._rebuilt, self._stranger, self._genuine),
            *([self._of_another_epoch] * 2 if self._epoch is not None else []),
        ]

    def learn(self, data: bytes) -> None:
        """Take a genuine message."""
        self._samples.append(sample_of(self._kind.decode(data)))
        if len(self._samples) > 16:
            del self._samples[self._random.randrange(16)]

    def invalid(self) -> bytes:
        """Return a message that is malformed or of another run."""
        return self._random.choice(self._invalid)()

    def anything(self) -> bytes:
        """Return any message; it may be well-formed and of the flight's own run."""
        return self._random.choice(self._any)()

    def _sample(self) -> Sample:
        return self._random.choice(self._samples or self._strangers)

    # --- invalid ---

    def _noise(self) -> bytes:
        """Random bytes: too short for a message of this kind."""
        least = len(ENCAPSULATION) + sum(SIZES.get(kind, 4) for kind in self._kind.KINDS)
        data = self._random.randbytes(self._random.randrange(least))
        return ENCAPSULATION + data[4:] if self._random.random() < 0.7 else data

    def _cut(self) -> bytes:
        data = self._sample().data
        return data[: self._random.randrange(len(data))]

    def _encapsulated(self) -> bytes:
        """Another encapsulation: before the same bytes or, for big-endian, swapped ones."""
        sample = self._sample()
        other = self._random.choice(OTHER_ENCAPSULATIONS)
        if other[1] in (0, 2, 6) and self._random.random() < 0.5:
            data = bytearray(sample.data)
            for place in sample.places:
                data[place.at : place.at + SIZES.get(place.kind, 4)] = data[
                    place.at : place.at + SIZES.get(place.kind, 4)
                ][::-1]
            return other + bytes(data[4:])
        return other + sample.data[4:]

    def _too_long(self) -> bytes:
        sample = self._sample()
        lengths = [place for place in sample.places if place.kind in ("text", "numbers")]
        if not lengths:
            return self._cut()
        return self._put(
            sample, self._random.choice(lengths).at, "I", self._random.choice(TOO_LONG)
        )

    def _of_another_run(self) -> bytes:
        sample = self._sample()
        assert self._run is not None
        assert self._run_id is not None
        near = self._run_id ^ 1 << self._random.randrange(64)
        other = self._random.choice([0 if self._run_id else near, near, near])
        data = self._put(sample, sample.places[self._run].at, "Q", other)
        return data if self._random.random() < 0.7 else self._odd_number(sample, data)

    def _not_utf8(self) -> bytes:
        sample = self._sample()
        texts = [place for place in sample.places if place.kind == "text" and place.size > 1]
        if not texts:
            return self._cut()
        place = self._random.choice(texts)
        data = bytearray(sample.data)
        data[place.first + self._random.randrange(place.size - 1)] = self._random.choice(
            (0xFF, 0xC0, 0xFE)
        )
        return bytes(data)

    # --- anything ---

    def _genuine(self) -> bytes:
        return self._sample().data

    def _stranger(self) -> bytes:
        return self._random.choice(self._strangers or self._samples).data

    def _flipped(self) -> bytes:
        data = bytearray(self._sample().data)
        for _ in range(self._random.choice((1, 1, 2, 8))):
            bit = self._random.randrange(8 * len(data))
            data[bit // 8] ^= 1 << bit % 8
        return bytes(data)

    def _odd_value(self) -> bytes:
        sample = self._sample()
        data = sample.data
        for _ in range(self._random.choice((1, 1, 2, 4))):
            data = self._odd_number(sample, data)
        return data

    def _odd_number(self, sample: Sample, data: bytes) -> bytes:
        """Replace a number: a field, or one of a sequence. Run ids are kept."""
        random = self._random
        k = random.randrange(len(sample.places))
        place = sample.places[k]
        if place.kind == "text" or k == self._run:
            return data
        if place.kind == "numbers":
            if not place.size:
                return data
            at = place.first + 8 * random.randrange(place.size // 8)
            return self._write(data, at, "d", random.choice(REALS))
        if place.kind == "d":
            return self._write(data, place.at, "d", random.choice(REALS))
        value = random.choice(INTEGERS)
        if random.random() < 0.4:  # near the genuine value
            size = SIZES[place.kind]
            value = int.from_bytes(data[place.at : place.at + size], "little")
            value += random.choice((-1000, -5, -1, 1, 2, 5, 64, 1000))
        return self._write(data, place.at, place.kind, value)

    def _of_another_epoch(self) -> bytes:
        sample = self._sample()
        assert self._epoch is not None
        epoch = sample.message.epoch + self._random.choice(EPOCHS_AWAY)  # type: ignore[attr-defined]
        return self._put(sample, sample.places[self._epoch].at, "I", epoch)

    def _longer(self) -> bytes:
        more = self._random.choice((1, 3, 4, 8, 100, 10_000))
        return self._sample().data + self._random.randbytes(more)

    def _resized(self) -> bytes:
        """One more or one less in a length, without a change of the bytes."""
        sample = self._sample()
        lengths = [place for place in sample.places if place.kind in ("text", "numbers")]
        if not lengths:
            return self._flipped()
        at = self._random.choice(lengths).at
        (length,) = struct.unpack_from("<I", sample.data, at)
        return self._put(sample, at, "I", length + self._random.choice((-1, 1, 2, -length)))

    def _rebuilt(self) -> bytes:
        """A well-formed message, whose texts and sequences are others."""
        random, data = self._random, bytearray(ENCAPSULATION)
        for k, (_, kind, value) in enumerate(self._sample().message._fields()):
            new: Any = value
            if random.random() < 0.4 and k != self._run:
                if kind == "text":
                    new = self._text(value)
                elif kind == "numbers":
                    size = random.choice((0, 1, len(value), len(value) + 1, 6, 1000))
                    new = np.array([random.choice(REALS) for _ in range(size)])
                elif kind == "d":
                    new = random.choice(REALS)
            put(data, kind, new)
        return bytes(data)

    def _text(self, genuine: str) -> str:
        """Another text; instead of a JSON object often one with another value."""
        random = self._random
        if not genuine.startswith("{") or random.random() < 0.3:
            return random.choice(TEXTS)
        said = json.loads(genuine)
        key = random.choice([*said, "real_time_factor", "laws", random.choice(VALUES)])
        said[key] = random.choice(
            [
                *(random.choice(REALS), random.choice(INTEGERS), random.choice(VALUES), True, None),
                *([random.choice(ENTRIES)], {}, [[]], 10**400, [1.0] * 5000, "nearest", 10**9),
            ]
        )
        return json.dumps(said)

    def _put(self, sample: Sample, at: int, kind: str, value: int | float) -> bytes:
        return self._write(sample.data, at, kind, value)

    @staticmethod
    def _write(data: bytes, at: int, kind: str, value: int | float) -> bytes:
        """Return `data` with another number; integers are taken modulo their range."""
        if kind == "d":
            raw = struct.pack("<d", value)
        else:
            size = SIZES[kind]
            raw = (int(value) % (1 << 8 * size)).to_bytes(size, "little")
        return data[:at] + raw + data[at + len(raw) :] if at + len(raw) <= len(data) else data
