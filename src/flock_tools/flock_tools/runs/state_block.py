# SPDX-License-Identifier: Apache-2.0
"""Bulk reading of serialised states in Flock's layout."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from flock_sim.physics.arrays import FloatArray
from flock_sim.messages.types import (
    ARRAYS,
    ENCAPSULATION,
    FRAME,
    STATE_ENVELOPE,
    STATE_STEP_AT,
    State,
)

HEAD = 44  # bytes before the arrays: encapsulation, header, step and time
TAIL = STATE_ENVELOPE.size  # bytes after them: run id and epoch
_FRAME = (len(FRAME) + 1).to_bytes(4, "little") + FRAME.encode() + b"\0"
_FRAME_AT = 12
_COUNT = 8  # bytes of an array's length, with the padding after it


def members_of(data: bytes) -> int:
    """Return the number of members of a state in Flock's layout; 0 for another layout."""
    members, count, (first, second, third, fourth) = _layout(len(data))
    starts = data.startswith
    if (
        starts(ENCAPSULATION)
        and starts(_FRAME, _FRAME_AT)
        and starts(count, first)
        and starts(count, second)
        and starts(count, third)
        and starts(count, fourth)
    ):
        return members
    return 0


@lru_cache(maxsize=64)  # the states of a bag usually have one length
def _layout(size: int) -> tuple[int, bytes, list[int]]:
    """Return the members of a state of `size` bytes, and the bytes and places of array counts."""
    stride, rest = divmod(size - HEAD - TAIL, len(ARRAYS))
    members, more = divmod(stride - _COUNT, 8)
    if rest or more or members < 1:
        return 0, b"", [0, 0, 0, 0]
    return members, members.to_bytes(4, "little"), [HEAD + k * stride for k in range(len(ARRAYS))]


def same_head(one: bytes, other: bytes) -> bool:
    """Return whether two states are equal up to their arrays, and thus of one step."""
    return one[:HEAD] == other[:HEAD] and one.startswith(_FRAME, _FRAME_AT)


def step_of(data: bytes) -> int:
    """Return the step of any serialised state. Raises ValueError if it is no state."""
    return State.step_of(data) if members_of(data) else State.decode(data).step


def steps_of(states: Sequence[bytes]) -> npt.NDArray[np.int64]:
    """Return the steps of states that all have `members_of` above 0, shape (states,)."""
    steps = b"".join(state[STATE_STEP_AT : STATE_STEP_AT + 8] for state in states)
    return np.frombuffer(steps, dtype="<u8").astype(np.int64)


def values_of(states: Sequence[bytes], members: int) -> FloatArray:
    """Return the arrays of states whose `members_of` is `members`, shape (states, 4, members)."""
    array = np.dtype([("count", f"V{_COUNT}"), ("values", "<f8", (members,))])
    state = np.dtype(
        [("head", f"V{HEAD}"), ("arrays", array, (len(ARRAYS),)), ("tail", f"V{TAIL}")]
    )
    values: FloatArray = np.frombuffer(b"".join(states), dtype=state)["arrays"]["values"]
    return values
