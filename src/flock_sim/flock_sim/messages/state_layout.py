# SPDX-License-Identifier: Apache-2.0
"""Bulk reading of serialised states in Flock's layout."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from flock_sim.messages.cdr import ENCAPSULATION
from flock_sim.messages.types import (
    ARRAYS,
    STATE_FRAME,
    STATE_FRAME_AT,
    STATE_HEAD,
    STATE_NUMBERS_AT,
    STATE_STEP_AT,
    State,
)
from flock_sim.physics.arrays import FloatArray


def members_of(data: bytes) -> int:
    """Return the number of members of a state in Flock's layout; 0 for another layout."""
    members, lengths = _layout(len(data))
    if (
        members
        and data.startswith(ENCAPSULATION)
        and data.startswith(STATE_FRAME, STATE_FRAME_AT)
        and set(lengths.unpack(data)) == {members}
    ):
        return members
    return 0


@lru_cache(maxsize=64)  # the states of a bag usually have one length
def _layout(size: int) -> tuple[int, struct.Struct]:
    """Return the members of a state of `size` bytes (0: none has it) and its `State.lengths`."""
    members, rest = divmod(size - State.lengths(0).size, 8 * len(ARRAYS))
    if rest or members < 1:
        members = 0
    return members, State.lengths(members)


def same_head(one: bytes, other: bytes) -> bool:
    """Return whether two states are equal up to their arrays, and thus of one step."""
    return one[:STATE_HEAD] == other[:STATE_HEAD] and one.startswith(STATE_FRAME, STATE_FRAME_AT)


def step_of(data: bytes) -> int:
    """Return the step of any serialised state. Raises ValueError if it is no state."""
    return State.step_of(data) if members_of(data) else State.decode(data).step


def steps_of(states: Sequence[bytes]) -> npt.NDArray[np.int64]:
    """Return the steps of states that all have `members_of` above 0, shape (states,)."""
    steps = b"".join(state[STATE_STEP_AT : STATE_STEP_AT + 8] for state in states)
    return np.frombuffer(steps, dtype="<u8").astype(np.int64)


def values_of(states: Sequence[bytes], members: int) -> FloatArray:
    """Return the arrays of states whose `members_of` is `members`, shape (states, 4, members)."""
    values: FloatArray = fields_of(b"".join(states), members)[2]
    return values


def fields_of(states: bytes, members: int) -> tuple[npt.NDArray[np.uint64], FloatArray, FloatArray]:
    """Return the fields of joined states whose `members_of` is `members`.

    These are step and time, of shape (states,), and the arrays, of shape (states, 4, members).
    """
    fields = np.frombuffer(states, dtype=_fields(members))
    return fields["step"], fields["time"], fields["arrays"]["values"]


@lru_cache(maxsize=64)
def _fields(members: int) -> np.dtype[np.void]:
    array = np.dtype([("count", f"V{STATE_NUMBERS_AT}"), ("values", "<f8", (members,))])
    return np.dtype(
        {
            "names": ["step", "time", "arrays"],
            "formats": ["<u8", "<f8", (array, (len(ARRAYS),))],
            "offsets": [STATE_STEP_AT, STATE_STEP_AT + 8, STATE_HEAD],
            "itemsize": State.lengths(members).size,
        }
    )
