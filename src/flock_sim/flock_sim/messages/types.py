# SPDX-License-Identifier: Apache-2.0
"""Flock's messages as plain data, and as the bytes (CDR) that are sent and recorded.

The definitions are those of `flock_interfaces`; a test compares them with the generated ones.
With these classes, the state machines, the recorder and the offline tools need no ROS.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import ClassVar

import numpy as np

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.configuration.perturbation import Perturbation
from flock_sim.errors import FlockError
from flock_sim.messages.cdr import (
    ENCAPSULATION,
    Float64,
    Int32,
    Int64,
    Numbers,
    Text,
    UInt8,
    UInt32,
    UInt64,
    fixed_layout,
    step_at,
)
from flock_sim.messages.cdr import Message as Message
from flock_sim.messages.state import BILLION as BILLION
from flock_sim.messages.state import State as State


@dataclass(frozen=True, slots=True)
class Wing(Message):
    """BirdWing: the geometry of a bird. `span_ratio` has shape (members,)."""

    TYPE: ClassVar[str] = "flock_interfaces/msg/BirdWing"

    run_id: UInt64
    bird: UInt32
    span_ratio: Numbers


@dataclass(frozen=True, slots=True)
class Stage(Message):
    """BirdStage: one Runge-Kutta stage of a bird; arrays of shape (members,), in b and U_min."""

    TYPE: ClassVar[str] = "flock_interfaces/msg/BirdStage"

    run_id: UInt64
    step: UInt64
    epoch: UInt32
    bird: UInt32
    stage: UInt8
    position: Numbers
    speed: Numbers
    circulation: Numbers

    @staticmethod
    def header(data: bytes) -> tuple[int, int, int, int, int, int]:
        """Return run id, step, epoch, bird, stage and members of an encoded stage."""
        if len(data) < len(ENCAPSULATION) + STAGE_HEADER.size:
            raise ValueError(f"stage message of {len(data)} bytes is too short")
        run_id, step, epoch, bird, stage, members = STAGE_HEADER.unpack_from(
            data, len(ENCAPSULATION)
        )
        return run_id, step, epoch, bird, stage, members


@dataclass(frozen=True, slots=True)
class Grant(Message):
    """Grant: birds may go up to the beginning of `step`; the run ends at step `end`.

    `terms` is the configuration as `messages.handshake` writes it; `perturbation` is the id of the
    last perturbation that was requested in flight.
    """

    TYPE: ClassVar[str] = "flock_interfaces/msg/Grant"

    run_id: UInt64
    step: UInt64
    end: UInt64
    dt: Float64
    epoch: UInt32
    terms: Text = ""
    perturbation: UInt64 = 0


@dataclass(frozen=True, slots=True)
class Progress(Message):
    """Progress: a bird has reached `step`, or the recorder has all steps up to `step` on disk.

    `who` names the node. Its process draws `life`, the incarnation, at random: a restarted process
    has another one.
    """

    TYPE: ClassVar[str] = "flock_interfaces/msg/Progress"

    run_id: UInt64
    step: Int64
    epoch: UInt32
    who: Text
    life: UInt64 = 0


@dataclass(frozen=True, slots=True)
class Memory(Message):
    """BirdMemory: what a bird remembers of received messages at the beginning of `step`.

    `data` has shape (vectors * members,), those of `protocol.link_receiver`.
    """

    TYPE: ClassVar[str] = "flock_interfaces/msg/BirdMemory"

    run_id: UInt64
    step: UInt64
    epoch: UInt32
    bird: UInt32
    data: Numbers

    @staticmethod
    def step_of(data: bytes) -> int:
        """Return the step of an encoded memory, without decoding it."""
        return step_at(Memory, data, MEMORY_STEP_AT)


@dataclass(frozen=True, slots=True)
class Ages(Message):
    """BirdAges: the ages of a bird's data on its neighbours, in a free flight.

    `age`, `age_max` (both in s) and `behind` (in steps) have shape (neighbours,).
    """

    TYPE: ClassVar[str] = "flock_interfaces/msg/BirdAges"

    run_id: UInt64
    step: UInt64
    epoch: UInt32
    bird: UInt32
    age: Numbers
    age_max: Numbers
    behind: Numbers
    late: UInt64
    lateness: Float64


@dataclass(frozen=True, slots=True)
class Checkpoint(Message):
    """Checkpoint: `epoch` begins at `step`, the last step on disk.

    `position` and `speed` have shape (birds * members,), bird by bird; they are empty if the flight
    starts at its beginning. `perturbations` are those requested in flight so far, separated by
    spaces. `memory` joins the memories of all birds; it is empty if no bird has one.
    `forcing_state` joins those of the states of all birds.
    """

    TYPE: ClassVar[str] = "flock_interfaces/msg/Checkpoint"

    run_id: UInt64
    step: UInt64
    epoch: UInt32
    position: Numbers
    speed: Numbers
    perturbations: Text = ""
    memory: Numbers = field(default_factory=lambda: np.empty(0))
    forcing_state: Numbers = field(default_factory=lambda: np.empty(0))

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

    run_id: UInt64
    step: UInt64
    position: Float64
    speed: Float64
    number: UInt32
    bird: UInt32
    member: UInt32

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

    seconds: Int32
    nanoseconds: UInt32

    @classmethod
    def at(cls, stamp: int) -> Time:
        """Return the message for a simulated time of `stamp` ns."""
        return cls(*divmod(stamp, BILLION))

    @property
    def stamp(self) -> int:
        """Simulated time, in ns."""
        return self.seconds * BILLION + self.nanoseconds


# The layout of encoded messages, in bytes, for code that does not decode them.
STAGE_HEADER = fixed_layout(*Stage.KINDS[: Stage.KINDS.index("numbers")], "I")
MEMORY_STEP_AT = Memory(0, 0, 0, 0, np.empty(0)).place("step")
