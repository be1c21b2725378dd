# SPDX-License-Identifier: Apache-2.0
"""The state message of a bird, and its layout in bytes for code that does not decode it."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.messages.cdr import (
    ENCAPSULATION,
    Float64,
    Int32,
    Message,
    Numbers,
    Text,
    UInt32,
    UInt64,
    fixed_layout,
    step_at,
)
from flock_sim.physics.arrays import FloatArray
from flock_sim.physics.flock_state import FlockState

FRAME = "world"
"""The frame of positions: the air is at rest in it, and its x axis is the direction of flight."""

EARLIER_FRAME = "flock"
"""The same in bags of earlier versions. It is as long, so the layouts are the same."""

FRAMES = {FRAME, EARLIER_FRAME}

BILLION = 1_000_000_000

ARRAYS = (
    "position",
    "speed",
    "circulation",
    "interaction_drag",
    "mean_speed",
    "mean_interaction_drag",
)
"""The fields of a state that have one value per member, in the order of the message."""

VALUES, MEANS = ARRAYS[:4], ARRAYS[4:]
"""The values at the time of a state, and the means.

States of earlier versions lack the means and `forcing_state`.
"""

NOTHING = np.empty(0)


@dataclass(frozen=True, slots=True)
class State(Message):
    """BirdState: a bird at the beginning of a step; arrays of shape (members,), dimensionless.

    The means are over all steps since the last recorded state, this step included. A state that was
    recorded by an earlier version has neither these nor `forcing_state`: they are empty.
    `forcing_state` has shape (numbers * members,): the state of the laws that act on the bird.
    """

    TYPE: ClassVar[str] = "flock_interfaces/msg/BirdState"

    seconds: Int32
    nanoseconds: UInt32
    frame: Text
    step: UInt64
    time: Float64
    position: Numbers
    speed: Numbers
    circulation: Numbers
    interaction_drag: Numbers
    mean_speed: Numbers
    mean_interaction_drag: Numbers
    forcing_state: Numbers = field(default_factory=lambda: NOTHING)
    run_id: UInt64 = 0
    epoch: UInt32 = 0

    def encode(self) -> bytes:
        """Return the message as CDR: the bytes of `Message.encode`, in a third of the time."""
        arrays = (
            self.position,
            self.speed,
            self.circulation,
            self.interaction_drag,
            self.mean_speed,
            self.mean_interaction_drag,
        )
        if self.frame != FRAME or not all(map(len, arrays)):
            return Message.encode(self)
        stamp = self.seconds, self.nanoseconds
        parts = [_HEAD.pack(ENCAPSULATION, *stamp, *_FRAME, self.step, self.time)]
        for values in (*arrays, self.forcing_state):
            parts.append(_COUNT.pack(len(values)))
            parts.append(np.asarray(values, dtype=_NUMBER).tobytes())
        parts.append(STATE_ENVELOPE.pack(self.run_id, self.epoch))
        return b"".join(parts)

    @classmethod
    def decode(cls, data: bytes) -> State:
        """Return the state in `data`, also of an earlier version. Raises ValueError as Message."""
        try:
            return cls(*cls.values_in(data, cls.KINDS))
        except ValueError:
            missing = len(MEANS) + 1  # and forcing_state
            kinds = [*cls.KINDS[: -missing - 2], *cls.KINDS[-2:]]
            *values, run_id, epoch = cls.values_in(data, kinds)
            early = cls(*[*values, *missing * [NOTHING], run_id, epoch])
            if len(data) != cls.early_lengths(len(early.position)).size:
                raise
            return early

    @staticmethod
    def step_of(data: bytes) -> int:
        """Return the step of an encoded state, without decoding it."""
        return step_at(State, data, STATE_STEP_AT)

    @staticmethod
    def step_and_time_of(data: bytes) -> tuple[int, float]:
        """Return step and time of a state in Flock's layout, without decoding it."""
        step, time = _STEP_AND_TIME.unpack_from(data, STATE_STEP_AT)
        return step, time

    @staticmethod
    def lengths(members: int, forcing: int = 0, means: bool = True) -> struct.Struct:
        """Return the struct that reads the array lengths of an encoded state of `members`.

        `forcing` is the length of `forcing_state`. Without `means`, these arrays are empty.
        """
        arrays = len(VALUES) * _array(members)
        arrays += len(MEANS) * (_array(members) if means else _EMPTY) + _array(forcing)
        return struct.Struct(f"<{STATE_HEAD}x{arrays}{STATE_ENVELOPE.size}x")

    @staticmethod
    def early_lengths(members: int) -> struct.Struct:
        """Do the same for a state of an earlier version, without means and forcing state."""
        arrays = len(VALUES) * _array(members)
        return struct.Struct(f"<{STATE_HEAD}x{arrays}{STATE_ENVELOPE.size}x")

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
        mean_speed: FloatArray,
        mean_interaction_drag: FloatArray,
        forcing_state: FloatArray = NOTHING,
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
            mean_speed,
            mean_interaction_drag,
            forcing_state,
            run_id,
            epoch,
        )

    @classmethod
    def of_flock(cls, configuration: FlockConfiguration, flock: FlockState) -> list[State]:
        """Return the states of bird 1, 2, ... N of a flock at a recorded step."""
        return [
            cls.at(
                configuration,
                flock.step,
                flock.position[i],
                flock.speed[i],
                flock.circulation[i],
                flock.interaction_drag[i],
                flock.mean_speed[i],
                flock.mean_interaction_drag[i],
                flock.forcing_state[i].ravel() if flock.forcing_state.size else NOTHING,
            )
            for i in range(configuration.birds)
        ]


def _array(length: int) -> str:
    """Return the format of an array whose length is read and whose numbers are skipped."""
    return f"I{STATE_NUMBERS_AT - 4}x{8 * length}x"


_EMPTY = "I"
"""Format of an empty array before another array: no padding follows its length."""

STATE_ENVELOPE = fixed_layout(*State.KINDS[-2:])
"""Run id and epoch, the last fields of a state."""
_FRAME = len(FRAME) + 1, FRAME.encode()
_HEAD = struct.Struct(f"<4siII{len(FRAME) + 1}s{-(len(FRAME) + 13) % 8}xQd")
"""The fields before the arrays, with the encapsulation."""
_STEP_AND_TIME = struct.Struct("<Qd")
"""The last two of them."""
_COUNT = struct.Struct("<I4x")
"""The length of an array, and the padding before its numbers, or before the envelope."""
_NUMBER = np.dtype("<f8")
_ONE = np.zeros(1)
_STATE = State(0, 0, FRAME, 0, 0.0, _ONE, _ONE, _ONE, _ONE, _ONE, _ONE)
STATE_STEP_AT = _STATE.place("step")
STATE_FRAME_AT = _STATE.place("frame")
STATE_FRAMES = tuple(
    struct.pack(f"<I{len(name) + 1}s", len(name) + 1, name.encode())
    for name in (FRAME, EARLIER_FRAME)
)
"""The frames in a state: length, text and a zero."""
STATE_HEAD = _STATE.place(ARRAYS[0])
"""Size of the fields before the arrays, with the encapsulation."""
STATE_NUMBERS_AT = _STATE.place(ARRAYS[1]) - STATE_HEAD - 8
"""Offset of the numbers of an array: its length and the padding come first."""
