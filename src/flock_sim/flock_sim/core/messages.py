# SPDX-License-Identifier: Apache-2.0
"""Flock's messages as plain data, and as the bytes that travel and are recorded (CDR).

The definitions are those of `flock_interfaces`; a test holds these against the generated ones.
Having them here lets the core, the recorder and the offline tools work on bytes without ROS.
"""

from __future__ import annotations

import struct
from dataclasses import asdict, dataclass, field, fields
from typing import Any, ClassVar, Self

import numpy as np

from flock_sim.core.configuration import FlockConfiguration
from flock_sim.core.kernel import FloatArray
from flock_sim.core.perturbation import Perturbation

ENCAPSULATION = b"\x00\x01\x00\x00"  # plain CDR, little-endian
FRAME = "flock"
STATE_ENVELOPE = struct.Struct("<QI")  # run id and epoch, the last fields of a state
MEMORY_STEP_AT = 12  # encapsulation 4, run id 8
STATE_STEP_AT = 28  # encapsulation 4, stamp 8, length of FRAME 4, FRAME and its zero 6, padding 6

BILLION = 1_000_000_000


class Message:
    """A message whose fields are given, in order, by CDR kinds.

    Kinds are those of `struct` (Q, q, I, i, B, d), "text" and "numbers" (a float64 sequence).
    """

    TYPE: ClassVar[str]
    KINDS: ClassVar[tuple[str, ...]]

    def encode(self) -> bytes:
        """Return the message as CDR, encapsulation header included."""
        data = bytearray(ENCAPSULATION)
        for kind, value in zip(self.KINDS, self._values(), strict=True):
            if kind == "numbers":
                put(data, "I", len(value))
                if len(value):
                    align(data, 8)
                    data += np.ascontiguousarray(value, dtype="<f8").tobytes()
            else:
                put(data, kind, value)
        return bytes(data)

    @classmethod
    def decode(cls, data: bytes) -> Self:
        """Return the message in `data`. Raises ValueError if it does not hold one."""
        if data[:4] != ENCAPSULATION:
            raise ValueError(f"{cls.TYPE}: not little-endian CDR")
        values: list[object] = []
        at = 4
        try:
            for kind in cls.KINDS:
                first = "I" if kind in ("text", "numbers") else kind
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
        return cls(*values)

    def _values(self) -> tuple[Any, ...]:
        return tuple(getattr(self, each.name) for each in fields(self))  # type: ignore[arg-type]


def align(data: bytearray, size: int) -> None:
    """Fill up `data`, CDR with its encapsulation header, to where something of `size` may begin."""
    data += bytes((4 - len(data)) % size)


def put(data: bytearray, kind: str, value: object) -> None:
    """Append `value` as CDR; `kind` is that of `struct`, or "text"."""
    if kind == "text":
        text = str(value).encode() + b"\0"
        put(data, "I", len(text))
        data += text
        return
    align(data, struct.calcsize(kind))
    data += struct.pack("<" + kind, value)


@dataclass(frozen=True, slots=True)
class Wing(Message):
    """BirdWing: the geometry of a bird. `span_ratio` has shape (members,)."""

    TYPE: ClassVar[str] = "flock_interfaces/msg/BirdWing"
    KINDS: ClassVar[tuple[str, ...]] = ("Q", "I", "numbers")

    run_id: int
    bird: int
    span_ratio: FloatArray


@dataclass(frozen=True, slots=True)
class Stage(Message):
    """BirdStage: one Runge-Kutta stage of a bird; arrays of shape (members,), in b and U_min."""

    TYPE: ClassVar[str] = "flock_interfaces/msg/BirdStage"
    KINDS: ClassVar[tuple[str, ...]] = ("Q", "Q", "I", "I", "B", "numbers", "numbers", "numbers")

    run_id: int
    step: int
    epoch: int
    bird: int
    stage: int
    position: FloatArray
    speed: FloatArray
    circulation: FloatArray


@dataclass(frozen=True, slots=True)
class State(Message):
    """BirdState: a bird at the beginning of a step; arrays of shape (members,), dimensionless."""

    TYPE: ClassVar[str] = "flock_interfaces/msg/BirdState"
    KINDS: ClassVar[tuple[str, ...]] = ("i", "I", "text", "Q", "d", *4 * ("numbers",), "Q", "I")

    seconds: int
    nanoseconds: int
    frame: str
    step: int
    time: float
    position: FloatArray
    speed: FloatArray
    circulation: FloatArray
    interaction_drag: FloatArray
    run_id: int = 0
    epoch: int = 0

    @staticmethod
    def step_of(data: bytes) -> int:
        """Return the step of an encoded state, without decoding it."""
        if len(data) < STATE_STEP_AT + 8:
            raise ValueError(f"{State.TYPE}: {len(data)} bytes are too few")
        return int.from_bytes(data[STATE_STEP_AT : STATE_STEP_AT + 8], "little")

    @staticmethod
    def size(members: int) -> int:
        """Return the length of an encoded state of `members`, in bytes."""
        return STATE_STEP_AT + 16 + 4 * 8 * (members + 1) + STATE_ENVELOPE.size

    @staticmethod
    def envelope(data: bytes) -> tuple[int, int]:
        """Return run id and epoch of an encoded state, without decoding it."""
        run_id, epoch = STATE_ENVELOPE.unpack_from(data, len(data) - STATE_ENVELOPE.size)
        return run_id, epoch

    @staticmethod
    def opened(data: bytes) -> bytes:
        """Return an encoded state as it is recorded: of no run and no epoch."""
        return data[: -STATE_ENVELOPE.size] + bytes(STATE_ENVELOPE.size)

    @classmethod
    def at(
        cls,
        configuration: FlockConfiguration,
        step: int,
        position: FloatArray,
        speed: FloatArray,
        circulation: FloatArray,
        interaction_drag: FloatArray,
        run_id: int = 0,
        epoch: int = 0,
    ) -> State:
        """Return the state at the beginning of `step`, with its stamp and time."""
        return cls(
            *divmod(configuration.stamp(step), BILLION),
            FRAME,
            step,
            configuration.time(step),
            position,
            speed,
            circulation,
            interaction_drag,
            run_id,
            epoch,
        )


@dataclass(frozen=True, slots=True)
class Grant(Message):
    """Grant: birds may go up to the beginning of `step`; the run ends at step `end`.

    `terms` is what is flown, as `core.terms` writes it; `perturbation` the id of the last one asked
    for in flight.
    """

    TYPE: ClassVar[str] = "flock_interfaces/msg/Grant"
    KINDS: ClassVar[tuple[str, ...]] = ("Q", "Q", "Q", "d", "I", "text", "Q")

    run_id: int
    step: int
    end: int
    dt: float
    epoch: int
    terms: str = ""
    perturbation: int = 0


@dataclass(frozen=True, slots=True)
class Progress(Message):
    """Progress: a bird has reached `step`, or the recorder has all up to `step` on disk.

    `life` is drawn by the process that is `who`, which thereby is told from those before it.
    """

    TYPE: ClassVar[str] = "flock_interfaces/msg/Progress"
    KINDS: ClassVar[tuple[str, ...]] = ("Q", "q", "I", "text", "Q")

    run_id: int
    step: int
    epoch: int
    who: str
    life: int = 0


@dataclass(frozen=True, slots=True)
class Memory(Message):
    """BirdMemory: what a bird remembers, at the beginning of `step`, of what it has heard.

    `data` has shape (vectors * members,), those of `core.links.receiver`.
    """

    TYPE: ClassVar[str] = "flock_interfaces/msg/BirdMemory"
    KINDS: ClassVar[tuple[str, ...]] = ("Q", "Q", "I", "I", "numbers")

    run_id: int
    step: int
    epoch: int
    bird: int
    data: FloatArray

    @staticmethod
    def step_of(data: bytes) -> int:
        """Return the step of an encoded memory, without decoding it."""
        if len(data) < MEMORY_STEP_AT + 8:
            raise ValueError(f"{Memory.TYPE}: {len(data)} bytes are too few")
        return int.from_bytes(data[MEMORY_STEP_AT : MEMORY_STEP_AT + 8], "little")


@dataclass(frozen=True, slots=True)
class Ages(Message):
    """BirdAges: how old what a bird knew of its neighbours was, in a free flight.

    `age`, `age_max` (both in s) and `behind` (in steps) have shape (neighbours,).
    """

    TYPE: ClassVar[str] = "flock_interfaces/msg/BirdAges"
    KINDS: ClassVar[tuple[str, ...]] = ("Q", "Q", "I", "I", *3 * ("numbers",), "Q", "d")

    run_id: int
    step: int
    epoch: int
    bird: int
    age: FloatArray
    age_max: FloatArray
    behind: FloatArray
    late: int
    lateness: float


@dataclass(frozen=True, slots=True)
class Checkpoint(Message):
    """Checkpoint: where `epoch` begins: at `step`, the last one on disk.

    `position` and `speed` have shape (birds * members,), bird by bird; empty: the flight begins.
    `perturbations` are those asked for in flight so far, between spaces. `memory` is that of all
    birds in a row, empty where there is none.
    """

    TYPE: ClassVar[str] = "flock_interfaces/msg/Checkpoint"
    KINDS: ClassVar[tuple[str, ...]] = ("Q", "Q", "I", "numbers", "numbers", "text", "numbers")

    run_id: int
    step: int
    epoch: int
    position: FloatArray
    speed: FloatArray
    perturbations: str = ""
    memory: FloatArray = field(default_factory=lambda: np.empty(0))

    @classmethod
    def of_start(cls, run_id: int, epoch: int, perturbations: str = "") -> Checkpoint:
        """Return the checkpoint of a flight of which nothing is recorded."""
        return cls(run_id, 0, epoch, np.empty(0), np.empty(0), perturbations)


@dataclass(frozen=True, slots=True)
class Push(Message):
    """Perturbation: a push that was asked for in flight, the `number`-th (1, 2, ...) of its run."""

    TYPE: ClassVar[str] = "flock_interfaces/msg/Perturbation"
    KINDS: ClassVar[tuple[str, ...]] = ("Q", "Q", "d", "d", "I", "I", "I")

    run_id: int
    step: int
    position: float
    speed: float
    number: int
    bird: int
    member: int

    @classmethod
    def of(cls, run_id: int, number: int, perturbation: Perturbation) -> Push:
        """Return the message for a perturbation, the `number`-th of its run."""
        return cls(run_id, number=number, **asdict(perturbation))

    @property
    def perturbation(self) -> Perturbation:
        """What is done; whether the flight has such a bird, member and step is not checked."""
        return Perturbation(self.step, self.bird, self.member, self.position, self.speed)


@dataclass(frozen=True, slots=True)
class Time(Message):
    """rosgraph_msgs/Clock: simulated time."""

    TYPE: ClassVar[str] = "rosgraph_msgs/msg/Clock"
    KINDS: ClassVar[tuple[str, ...]] = ("i", "I")

    seconds: int
    nanoseconds: int

    @classmethod
    def at(cls, stamp: int) -> Time:
        """Return the message for a simulated time of `stamp` ns."""
        return cls(*divmod(stamp, BILLION))

    @property
    def stamp(self) -> int:
        """Simulated time, in ns."""
        return self.seconds * BILLION + self.nanoseconds
