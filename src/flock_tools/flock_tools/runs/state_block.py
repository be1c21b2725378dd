# SPDX-License-Identifier: Apache-2.0
"""Bulk reading of serialised states in Flock's layout."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from struct import Struct

import numpy as np
import numpy.typing as npt

from flock_sim.messages.types import (
    ARRAYS,
    ENCAPSULATION,
    FRAME,
    STATE_ENVELOPE,
    STATE_STEP_AT,
    State,
)
from flock_sim.physics.arrays import FloatArray

HEAD = STATE_STEP_AT + 16
"""Bytes before the arrays: encapsulation, header, step and time."""

TAIL = STATE_ENVELOPE.size
"""Bytes after the arrays: run id and epoch."""

_FRAME = (len(FRAME) + 1).to_bytes(4, "little") + FRAME.encode() + b"\0"
_FRAME_AT = 12
_COUNT = 8  # bytes of an array's length, with the padding after it


def members_of(data: bytes) -> int:
    """Return the number of members of a state in Flock's layout; 0 for another layout."""
    members, lengths = _layout(len(data))
    if (
        members
        and data.startswith(ENCAPSULATION)
        and data.startswith(_FRAME, _FRAME_AT)
        and lengths.unpack(data) == (members,) * len(ARRAYS)
    ):
        return members
    return 0


@lru_cache(maxsize=64)  # the states of a bag usually have one length
def _layout(size: int) -> tuple[int, Struct]:
    """Return the members of a state of `size` bytes, and the struct of its array lengths."""
    members, rest = divmod(size - State.lengths(0).size, 8 * len(ARRAYS))
    members = 0 if rest or members < 1 else members
    return members, State.lengths(members)


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
