# SPDX-License-Identifier: Apache-2.0
"""The layout of a stage message: the bytes of a BirdStage, and its numbers without a copy.

A BirdStage in CDR is an encapsulation, a header (run id, step, epoch, bird, stage, length of the
first sequence), then the sequences, each followed by the length of the next and padding. A message
is stored BEFORE bytes into an array, so that all its numbers are aligned words of 8 bytes.
"""

from __future__ import annotations

import struct

from flock_sim.messages.cdr import ENCAPSULATION
from flock_sim.messages.types import STAGE_HEADER as HEADER
from flock_sim.messages.types import Stage
from flock_sim.physics.arrays import FloatArray

WORD = 8
SEQUENCES = Stage.KINDS.count("numbers")

HEADER_AT = len(ENCAPSULATION)
HEADER_END = HEADER_AT + HEADER.size

BEFORE = -HEADER_END % WORD
"""Bytes before a stored message, so that its numbers are aligned."""

FIRST_WORD = (BEFORE + HEADER_END) // WORD
"""Offset of the positions, in words. Speeds and circulations follow, each members + 1 words on."""

HEADER_WORD = (BEFORE + HEADER_AT) // WORD
"""Offset of the header, in words: run id; step; epoch and bird; stage and members."""

HEADER_WORDS = HEADER.size // WORD


def stage_words(members: int) -> int:
    """Return the size of a stored stage message of `members`, in words."""
    return FIRST_WORD + SEQUENCES * (members + 1) - 1


def has_layout(data: bytes, members: int) -> bool:
    """Return whether `data` has the size, the encapsulation and the lengths of a stage."""
    length = struct.pack("<I", members)
    return (
        len(data) == WORD * stage_words(members) - BEFORE
        and data.startswith(ENCAPSULATION)
        and all(data.startswith(length, at) for at in _lengths_at(members))
    )


def _lengths_at(members: int) -> list[int]:
    """Return the offsets of the lengths of the sequences in a message, in bytes."""
    first = HEADER_END - 4  # the header ends with the first
    return [first, *(HEADER_END + WORD * (k * (members + 1) - 1) for k in range(1, SEQUENCES))]


def stage_bytes(words: FloatArray, members: int) -> memoryview:
    """Return `words`, shape (stage_words(members),), as the bytes of a stage message."""
    data = words.data.cast("B")[BEFORE:]
    data[:HEADER_AT] = ENCAPSULATION
    length = struct.pack("<I", members)
    for at in _lengths_at(members):
        data[at : at + len(length)] = length
    return data


def stage_numbers(words: FloatArray, members: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return position, speed and circulation in `words`, each of shape (members,)."""
    position, speed, circulation = (
        words[at : at + members]
        for at in range(FIRST_WORD, FIRST_WORD + SEQUENCES * (members + 1), members + 1)
    )
    return position, speed, circulation
