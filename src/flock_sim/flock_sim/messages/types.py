# SPDX-License-Identifier: Apache-2.0
"""Flock's messages as plain data, and as the bytes (CDR) that are sent and recorded.

The definitions are those of `flock_interfaces`; a test compares them with the generated ones.
With these classes, the state machines, the recorder and the offline tools need no ROS.
"""

from __future__ import annotations

import struct
from dataclasses import asdict, dataclass, field, fields
from typing import Any, ClassVar, Self

import numpy as np

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.configuration.perturbation import Perturbation
from flock_sim.errors import FlockError
from flock_sim.physics.arrays import FloatArray

ENCAPSULATION = b"\x00\x01\x00\x00"  # plain CDR, little-endian
FRAME = "flock"
STATE_ENVELOPE = struct.Struct("<QI")  # run id and epoch, the last fields of a state
MEMORY_STEP_AT = 12  # encapsulation 4, run id 8
STATE_STEP_AT = 28  # encapsulation 4, stamp 8, length of FRAME 4, FRAME and its zero 6, padding 6

BILLION = 1_000_000_000

ARRAYS = ("position", "speed", "circulation", "interaction_drag")
"""The fields of a state that have one value per member, in the order of the message."""


class Message:
    """A message; KINDS lists the CDR kinds of its fields, in order.

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
    """Pad `data`, CDR with its encapsulation header, so that a value of `size` bytes can follow."""
    data += bytes((4 - len(data)) % size)


def put(data: bytearray, kind: str, value: object) -> None:
    """Append `value` as CDR; `kind` is a `struct` format character, or "text"."""
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
    def lengths(members: int) -> struct.Struct:
        """Return the struct that reads the array lengths of an encoded state of `members`."""
        array = f"I4x{8 * members}x"
        return struct.Struct(f"<{STATE_STEP_AT + 16}x{array * len(ARRAYS)}{STATE_ENVELOPE.size}x")

    @staticmethod
    def envelope(data: bytes) -> tuple[int, int]:
        """Return run id and epoch of an encoded state, without decoding it."""
        run_id, epoch = STATE_ENVELOPE.unpack_from(data, len(data) - STATE_ENVELOPE.size)
        return run_id, epoch

    @staticmethod
    def opened(data: bytes) -> bytes:
        """Return an encoded state as it is recorded: with run id and epoch 0."""
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

    `terms` is the configuration as `messages.handshake` writes it; `perturbation` is the id of the
    last perturbation that was requested in flight.
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
    """Progress: a bird has reached `step`, or the recorder has all steps up to `step` on disk.

    `who` names the node. Its process draws `life`, the incarnation, at random: a restarted process
    has another one.
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
    """BirdMemory: what a bird remembers of received messages at the beginning of `step`.

    `data` has shape (vectors * members,), those of `protocol.link_receiver`.
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
    """BirdAges: the ages of a bird's data on its neighbours, in a free flight.

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
    """Checkpoint: `epoch` begins at `step`, the last step on disk.

    `position` and `speed` have shape (birds * members,), bird by bird; they are empty if the flight
    starts at its beginning. `perturbations` are those requested in flight so far, separated by
    spaces. `memory` joins the memories of all birds; it is empty if no bird has one.
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
        """Return the checkpoint of a flight that has no recorded step."""
        return cls(run_id, 0, epoch, np.empty(0), np.empty(0), perturbations)


@dataclass(frozen=True, slots=True)
class Push(Message):
    """Perturbation: a push that was requested in flight; `member` 0 means all members.

    `number` is the epoch that begins with the push. It is unique within a run.
    """

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
        """Return the message for a perturbation of one member."""
        return cls(run_id, number=number, **asdict(perturbation))

    def each(self, members: int) -> list[Perturbation]:
        """Return the push of each member, without a check that the flight has these members."""
        which = [self.member] if self.member else range(1, members + 1)
        return [Perturbation(self.step, self.bird, m, self.position, self.speed) for m in which]

    def check(self, configuration: FlockConfiguration) -> None:
        """Raise FlockError if the push does not fit the flight, or has no number."""
        if not self.number:
            raise FlockError(f"perturbation '{self}' has no number")
        for each in self.each(configuration.members):
            each.check(configuration.birds, configuration.members, configuration.steps)

    def __str__(self) -> str:
        member = f":{self.member}" if self.member else ""
        return f"{self.bird}{member}@{self.step}={self.position!r},{self.speed!r}"


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
