# SPDX-License-Identifier: Apache-2.0
"""The layout of a stage message: the bytes of a BirdStage, and its numbers without a copy.

A BirdStage in CDR is 4 bytes of encapsulation, a header (run id, step, epoch, bird, stage, length
of the first sequence), then the three sequences, each followed by the length of the next and
4 bytes of padding. Seen from 4 bytes before the message, all its numbers are aligned words of
8 bytes.
"""

from __future__ import annotations

import struct

from flock_sim.messages.types import ENCAPSULATION
from flock_sim.physics.arrays import FloatArray

HEADER = struct.Struct("<QQIIB3xI")
HEADER_AT = len(ENCAPSULATION)
HEADER_END = HEADER_AT + HEADER.size

FIRST_WORD = 5
"""Offset of the positions, in words. Speeds and circulations follow, each members + 1 words on."""


def stage_words(members: int) -> int:
    """Return the size of a stage message of `members`, in words, with the 4 bytes before it."""
    return FIRST_WORD + 3 * members + 2


def stage_bytes(words: FloatArray, members: int) -> memoryview:
    """Return `words`, shape (stage_words(members),), as the bytes of a stage message."""
    data = words.data.cast("B")[4:]
    data[:HEADER_AT] = ENCAPSULATION
    for sequence in range(3):
        numbers = HEADER_AT + HEADER.size + sequence * 8 * (members + 1)
        at = numbers - (8 if sequence else 4)  # the header ends with the first, without padding
        data[at : at + 4] = struct.pack("<I", members)
    return data


def stage_header(data: bytes) -> tuple[int, int, int, int, int, int]:
    """Return run id, step, epoch, bird, stage and members of an encoded stage message."""
    if len(data) < HEADER_AT + HEADER.size:
        raise ValueError(f"stage message of {len(data)} bytes is too short")
    run_id, step, epoch, bird, stage, members = HEADER.unpack_from(data, HEADER_AT)
    return run_id, step, epoch, bird, stage, members


def stage_numbers(words: FloatArray, members: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return position, speed and circulation in `words`, each of shape (members,)."""
    position, speed, circulation = (
        words[at : at + members]
        for at in range(FIRST_WORD, FIRST_WORD + 3 * (members + 1), members + 1)
    )
    return position, speed, circulation
