# SPDX-License-Identifier: Apache-2.0
"""Bulk reading of serialised states in Flock's layout."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from flock_sim.messages.cdr import ENCAPSULATION
from flock_sim.messages.state import (
    ARRAYS,
    MEANS,
    STATE_FRAME_AT,
    STATE_FRAMES,
    STATE_HEAD,
    STATE_NUMBERS_AT,
    STATE_STEP_AT,
    VALUES,
    State,
)
from flock_sim.physics.arrays import FloatArray

_COUNT = struct.Struct("<I")

_AFTER_FRAME = STATE_FRAME_AT + len(STATE_FRAMES[0])


@dataclass(frozen=True)
class Layout:
    """The lengths of the arrays of a state."""

    members: int
    forcing: int | None = 0
    """Length of `forcing_state`; None: of an earlier version, without means and this field."""
    means: bool = True
    """Whether the state has means. Those of a bird by another program may be empty."""

    @property
    def arrays(self) -> int:
        """Number of arrays with one value per member."""
        return len(ARRAYS if self.means else VALUES)

    @property
    def lengths(self) -> struct.Struct:
        """The struct that reads the array lengths."""
        if self.forcing is None:
            return State.early_lengths(self.members)
        return State.lengths(self.members, self.forcing, self.means)

    @property
    def size(self) -> int:
        """Size of the state, in bytes."""
        return self.lengths.size


def layout_of(data: bytes) -> Layout | None:
    """Return the layout of a state; None if it is not Flock's, or has no member."""
    if not (data.startswith(ENCAPSULATION) and data.startswith(STATE_FRAMES, STATE_FRAME_AT)):
        return None
    if len(data) < STATE_HEAD + _COUNT.size:
        return None
    (members,) = _COUNT.unpack_from(data, STATE_HEAD)
    if not 0 < 8 * members < len(data):
        return None
    means_at = STATE_HEAD + len(VALUES) * (STATE_NUMBERS_AT + 8 * members)
    means = len(data) < means_at + _COUNT.size or any(_COUNT.unpack_from(data, means_at))
    found = _layout(len(data), members, means)
    if found is None:
        return None
    layout, lengths, expected = found
    return layout if lengths.unpack(data) == expected else None


def compact(data: bytes) -> bytes:
    """Return a state without means as Flock encodes it; any other data as it is.

    Programs that do not compute the means send empty arrays, and their serialisers may add bytes.
    """
    try:
        state = State.decode(data)
    except ValueError:
        return data
    return data if len(state.mean_speed) else state.encode()


def members_of(data: bytes) -> int:
    """Return the number of members of a state in Flock's layout; 0 for another layout."""
    layout = layout_of(data)
    return layout.members if layout else 0


@lru_cache(maxsize=64)  # the states of a bag usually have one length
def _layout(
    size: int, members: int, means: bool
) -> tuple[Layout, struct.Struct, tuple[int, ...]] | None:
    """Return the layout of a state of `size` bytes, and the lengths of its arrays, with a struct.

    Returns None if there is no such layout.
    """
    layout = Layout(members, None, means=False)
    lengths = len(VALUES) * (members,)
    if size != layout.size:
        forcing, rest = divmod(size - Layout(members, 0, means).size, 8)
        if rest or forcing < 0:
            return None
        layout = Layout(members, forcing, means)
        lengths += len(MEANS) * (members if means else 0,) + (forcing,)
    return layout, layout.lengths, lengths


def same_head(one: bytes, other: bytes) -> bool:
    """Return whether two states are equal up to their arrays, and thus of one step.

    Both names of the frame mean the same.
    """
    return (
        one[:STATE_FRAME_AT] == other[:STATE_FRAME_AT]
        and one[_AFTER_FRAME:STATE_HEAD] == other[_AFTER_FRAME:STATE_HEAD]
        and one.startswith(STATE_FRAMES, STATE_FRAME_AT)
        and other.startswith(STATE_FRAMES, STATE_FRAME_AT)
    )


def step_of(data: bytes) -> int:
    """Return the step of any serialised state. Raises ValueError if it is no state."""
    return State.step_of(data) if members_of(data) else State.decode(data).step


def steps_of(states: Sequence[bytes]) -> npt.NDArray[np.int64]:
    """Return the steps of states that all have `members_of` above 0, shape (states,)."""
    steps = b"".join(state[STATE_STEP_AT : STATE_STEP_AT + 8] for state in states)
    return np.frombuffer(steps, dtype="<u8").astype(np.int64)


def times_of(states: Sequence[bytes]) -> FloatArray:
    """Return the times of such states, shape (states,)."""
    at = STATE_STEP_AT + 8
    return np.frombuffer(b"".join(state[at : at + 8] for state in states), dtype="<f8")


def values_of(states: Sequence[bytes], members: int) -> FloatArray:
    """Return the ARRAYS of states whose `members_of` is `members`, shape (states, 6, members).

    The means of states without them are nan.
    """
    values = np.full((len(states), len(ARRAYS), members), np.nan)
    for chosen, layout in _alike(states):
        arrays = fields_of(b"".join(states[k] for k in chosen), layout)[2]
        values[chosen, : layout.arrays] = arrays
    return values


def forcing_states_of(states: Sequence[bytes], numbers: int, members: int) -> FloatArray:
    """Return the forcing states of states as above, shape (states, numbers, members).

    Those of another length are nan.
    """
    values = np.full((len(states), numbers, members), np.nan)
    for chosen, layout in _alike(states):
        if numbers and layout.forcing == numbers * members:
            found = np.frombuffer(b"".join(states[k] for k in chosen), dtype=_fields(layout))
            values[chosen] = found["forcing"].reshape(-1, numbers, members)
    return values


def fields_of(
    states: bytes, layout: Layout
) -> tuple[npt.NDArray[np.uint64], FloatArray, FloatArray]:
    """Return the fields of joined states that all have `layout`.

    These are step and time, of shape (states,), and the arrays, of shape (states, 6 or 4, members).
    """
    fields = np.frombuffer(states, dtype=_fields(layout))
    return fields["step"], fields["time"], fields["arrays"]["values"]


def _alike(states: Sequence[bytes]) -> list[tuple[list[int], Layout]]:
    """Return the indices of states of one length, and their layout, for each length."""
    places: dict[int, list[int]] = {}
    for k, state in enumerate(states):
        places.setdefault(len(state), []).append(k)
    found = [(chosen, layout_of(states[chosen[0]])) for chosen in places.values()]
    return [(chosen, layout) for chosen, layout in found if layout]


@lru_cache(maxsize=64)
def _fields(layout: Layout) -> np.dtype[np.void]:
    array = np.dtype([("count", f"V{STATE_NUMBERS_AT}"), ("values", "<f8", (layout.members,))])
    head = STATE_HEAD + layout.arrays * array.itemsize
    if layout.forcing is not None and not layout.means:
        head += len(MEANS) * _COUNT.size  # the lengths of the empty arrays
    return np.dtype(
        {
            "names": ["step", "time", "arrays", "forcing"],
            "formats": ["<u8", "<f8", (array, (layout.arrays,)), ("<f8", (layout.forcing or 0,))],
            "offsets": [STATE_STEP_AT, STATE_STEP_AT + 8, STATE_HEAD, head + STATE_NUMBERS_AT],
            "itemsize": layout.size,
        }
    )
