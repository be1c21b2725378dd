# SPDX-License-Identifier: Apache-2.0
"""The words of a bird: where it is, what it waits for, and where its arrays are in memory.

The protocol (`protocol/bird.py`) and the compiled exchange (`ros/compiled_exchange.py`) read and
change the same words, so each continues where the other one stopped. Each rule of the hot path is
one function here, which both call.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from flock_sim.messages.cdr import ENCAPSULATION
from flock_sim.messages.stage_layout import (
    BEFORE,
    FIRST_WORD,
    HEADER_AT,
    HEADER_END,
    HEADER_WORD,
    HEADER_WORDS,
    SEQUENCES,
    WORD,
)
from flock_sim.physics.arrays import IntArray
from flock_sim.physics.compile import kernel
from flock_sim.physics.compiler import numba
from flock_sim.physics.native_call import ADDRESS, pointer
from flock_sim.physics.runge_kutta import STAGES

# The current tick; the tick from which on Python does more than exchange stages; the ticks of this
# exchange (between two exchanges: of the last one) and of the next one, and the side of this one.
TICK, END, EXCHANGE, NEXT, SIDE = range(5)
# The constant fields of the messages of this bird, their size in bytes, and its neighbours' number.
RUN_ID, EPOCH, BIRD, MEMBERS, SIZE, NEIGHBOURS = range(5, 11)
# Number of messages sent in this epoch, and of messages of other runs since they were counted.
SENT, FOREIGN = 11, 12
# Number of steps between recorded states.
EVERY = 13
# Number of messages that are lacking on each side.
LACKING = 14
# The addresses of the array arguments of `feel_and_move`, and of the last two messages sent.
OWN, INTERACTIONS, HEARD, MINE, WORK, SAID = range(16, 22)
# The address and the number of the words of its forcing; see `forcing/frame.py`.
FORCING, FORCING_WORDS = 22, 23
# The addresses of the publisher, of the buffer for incoming messages, and of the messages to send
# on each side: structures of rcl.
PUBLISHER, INCOMING, OUTGOING = 24, 25, 26
# The header of the message that is being checked.
HEADER = 28
# For each neighbour: its number, the address of the subscription to it, and whether its message has
# arrived on each side.
FIRST = HEADER + HEADER_WORDS
NAME, SUBSCRIPTION, HERE = range(3)
EACH = 4

LITTLE_ENDIAN = int.from_bytes(ENCAPSULATION, "little")

TAKEN, NOT_AWAITED, OTHER_RUN, NOT_FINITE, BROKEN = range(5)
"""Outcomes of `accept`."""

ANY = -1
"""Index of a neighbour that is found by the header of the message."""

copy: Any = numba.types.ExternalFunction("memcpy", ADDRESS(ADDRESS, ADDRESS, ADDRESS))
"""The C function, for messages, which are not aligned."""


@kernel
def put_header(
    header: IntArray, run_id: int, tick: int, epoch: int, bird: int, members: int
) -> None:
    """Write the HEADER_WORDS of the message of a bird at `tick` = STAGES step + stage."""
    header[0] = run_id
    header[1] = tick // STAGES
    header[2] = epoch | bird << 32
    header[3] = tick % STAGES | members << 32


@kernel
def has_header(
    header: IntArray, run_id: int, tick: int, epoch: int, bird: int, members: int
) -> bool:
    """Whether `put_header` would write these words."""
    return bool(
        header[0] == run_id
        and header[1] == tick // STAGES
        and header[2] == epoch | bird << 32
        and header[3] == tick % STAGES | members << 32
    )


@kernel
def row(words: IntArray, array: int, index: int) -> int:
    """Return the address of a stored stage message in the array HEARD, MINE or SAID."""
    return int(words[array] + (BEFORE + words[SIZE]) * index)


@kernel
def accept(words: IntArray, neighbour: int, address: int, size: int) -> int:
    """Take a message of a neighbour, an index or ANY, if this exchange or the next one lacks it.

    `address` and `size` are of the serialised message, in bytes. At the start of a flight, tick 0,
    all numbers must be finite. Returns TAKEN, or why the message is not taken.
    """
    if size != words[SIZE]:
        return NOT_AWAITED
    copy(words.ctypes.data + WORD * HEADER, address + HEADER_AT, WORD * HEADER_WORDS)
    header = words[HEADER:FIRST]
    if header[0] != words[RUN_ID]:
        return OTHER_RUN
    for k in range(words[NEIGHBOURS]) if neighbour == ANY else range(neighbour, neighbour + 1):
        at = FIRST + EACH * k
        for later in range(2):
            side = words[SIDE] ^ later
            tick = words[NEXT] if later else words[EXCHANGE]
            if words[at + HERE + side] or not has_header(
                header, words[RUN_ID], tick, words[EPOCH], words[at + NAME], words[MEMBERS]
            ):
                continue
            if not _is_stage(address, size, words[MEMBERS]):
                return BROKEN
            place = row(words, HEARD, side * words[NEIGHBOURS] + k)
            copy(place + BEFORE, address, size)
            count = (BEFORE + size) // WORD
            numbers = numba.carray(pointer(place), count, np.float64)[FIRST_WORD:]
            if tick == 0 and not _finite(numbers, words[MEMBERS]):
                return NOT_FINITE
            words[at + HERE + side] = 1
            words[LACKING + side] -= 1
            return TAKEN
    return NOT_AWAITED


@kernel
def _is_stage(address: int, size: int, members: int) -> bool:
    """Whether a message with the right header has the encapsulation and lengths of a stage."""
    parts = numba.carray(pointer(address), size // 4, np.int32)
    if parts[0] != LITTLE_ENDIAN:
        return False
    for sequence in range(1, SEQUENCES):
        if parts[(HEADER_END + WORD * (sequence * (members + 1) - 1)) // 4] != members:
            return False
    return True


@kernel
def _finite(numbers: Any, members: int) -> bool:
    """Whether all numbers of a message are finite; each sequence is followed by one other word."""
    for at in range(len(numbers)):
        if at % (members + 1) != members and not np.isfinite(numbers[at]):
            return False
    return True


@kernel
def begin_epoch(words: IntArray, tick: int, due: bool, following: int) -> None:
    """Begin an epoch at `tick`, which has an exchange if `due`; the next one is at `following`."""
    words[TICK] = words[EXCHANGE] = tick
    words[NEXT] = following
    words[SIDE] = tick & 1
    _lack(words, tick & 1, due)
    _lack(words, 1 - (tick & 1), True)


@kernel
def close(words: IntArray) -> None:
    """Take no messages until an epoch begins."""
    words[END] = words[SENT] = 0
    words[EXCHANGE] = words[NEXT] = -1
    _lack(words, 0, False)
    _lack(words, 1, False)


@kernel
def turn(words: IntArray, following: int) -> None:
    """Begin the exchange of the current tick; the one after it is at `following`."""
    words[EXCHANGE], words[NEXT] = words[TICK], following
    words[SIDE] = 1 - words[SIDE]
    _lack(words, 1 - words[SIDE], True)


@kernel
def _lack(words: IntArray, side: int, all_messages: bool) -> None:
    """Let a side lack all messages, or none."""
    count = words[NEIGHBOURS]
    words[LACKING + side] = count if all_messages else 0
    for k in range(count):
        words[FIRST + EACH * k + HERE + side] = 0 if all_messages else 1


@kernel
def say(words: IntArray) -> None:
    """Make the message of the current tick, which has an exchange, from the values in `mine`."""
    place = row(words, SAID, words[SIDE])
    copy(place, row(words, MINE, words[TICK] & 1), BEFORE + words[SIZE])
    header = numba.carray(pointer(place + WORD * HEADER_WORD), HEADER_WORDS, np.int64)
    put_header(header, words[RUN_ID], words[TICK], words[EPOCH], words[BIRD], words[MEMBERS])
    words[SENT] += 1
