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
    VALUES,
    State,
)
from flock_sim.physics.arrays import FloatArray


def members_of(data: bytes) -> int:
    """Return the number of members of a state in Flock's layout; 0 for another layout."""
    if data.startswith(ENCAPSULATION) and data.startswith(STATE_FRAME, STATE_FRAME_AT):
        for members, lengths in _layouts(len(data)):
            if set(lengths.unpack(data)) == {members}:
                return members
    return 0


def has_means(data: bytes, members: int) -> bool:
    """Whether a state whose `members_of` is `members` has means; earlier versions had none."""
    return len(data) == State.lengths(members).size


@lru_cache(maxsize=64)  # the states of a bag usually have one length
def _layouts(size: int) -> list[tuple[int, struct.Struct]]:
    """Return the members that a state of `size` bytes may have, each with its `State.lengths`."""
    found = []
    for arrays in (len(ARRAYS), len(VALUES)):
        members, rest = divmod(size - State.lengths(0, arrays).size, 8 * arrays)
        if members > 0 and not rest:
            found.append((members, State.lengths(members, arrays)))
    return found


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
    """Return the ARRAYS of states whose `members_of` is `members`, shape (states, 6, members).

    The means of states without them are nan.
    """
    if all(has_means(state, members) for state in states):
        return fields_of(b"".join(states), members)[2]
    values = np.full((len(states), len(ARRAYS), members), np.nan)
    for with_means in (True, False):
        chosen = [k for k, state in enumerate(states) if has_means(state, members) is with_means]
        if chosen:
            block = b"".join(states[k] for k in chosen)
            arrays = fields_of(block, members, with_means)[2]
            values[chosen, : arrays.shape[1]] = arrays
    return values


def fields_of(
    states: bytes, members: int, with_means: bool = True
) -> tuple[npt.NDArray[np.uint64], FloatArray, FloatArray]:
    """Return the fields of joined states that have `members`, and all means or none.

    These are step and time, of shape (states,), and the arrays, of shape (states, 6 or 4, members).
    """
    fields = np.frombuffer(states, dtype=_fields(members, with_means))
    return fields["step"], fields["time"], fields["arrays"]["values"]


@lru_cache(maxsize=64)
def _fields(members: int, with_means: bool) -> np.dtype[np.void]:
    arrays = len(ARRAYS if with_means else VALUES)
    array = np.dtype([("count", f"V{STATE_NUMBERS_AT}"), ("values", "<f8", (members,))])
    return np.dtype(
        {
            "names": ["step", "time", "arrays"],
            "formats": ["<u8", "<f8", (array, (arrays,))],
            "offsets": [STATE_STEP_AT, STATE_STEP_AT + 8, STATE_HEAD],
            "itemsize": State.lengths(members, arrays).size,
        }
    )
