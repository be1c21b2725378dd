# SPDX-License-Identifier: Apache-2.0
"""The layout of a stage message: the bytes of a BirdStage, and its numbers without a copy.

A BirdStage in CDR is an encapsulation, a header (run id, step, epoch, bird, stage, length of the
first sequence), then the sequences, each followed by the length of the next and padding. A message
is stored BEFORE bytes into an array, so that all its numbers are aligned words of 8 bytes.
"""

from __future__ import annotations

import struct

from flock_sim.messages.types import ENCAPSULATION, Stage
from flock_sim.physics.arrays import FloatArray

WORD = 8
SEQUENCES = Stage.KINDS.count("numbers")


def _cdr(*kinds: str) -> struct.Struct:
    """Return the CDR layout of fields of fixed size, each aligned to its own size."""
    layout = "<"
    for kind in kinds:
        layout += f"{-struct.calcsize(layout) % struct.calcsize(kind)}x{kind}"
    return struct.Struct(layout)


HEADER = _cdr(*Stage.KINDS[:-SEQUENCES], "I")
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


def stage_bytes(words: FloatArray, members: int) -> memoryview:
    """Return `words`, shape (stage_words(members),), as the bytes of a stage message."""
    data = words.data.cast("B")[BEFORE:]
    data[:HEADER_AT] = ENCAPSULATION
    length = struct.pack("<I", members)
    data[HEADER_END - len(length) : HEADER_END] = length  # the header ends with the first
    for sequence in range(1, SEQUENCES):
        at = HEADER_END + WORD * (sequence * (members + 1) - 1)
        data[at : at + len(length)] = length
    return data


def stage_header(data: bytes) -> tuple[int, int, int, int, int, int]:
    """Return run id, step, epoch, bird, stage and members of an encoded stage message."""
    if len(data) < HEADER_END:
        raise ValueError(f"stage message of {len(data)} bytes is too short")
    run_id, step, epoch, bird, stage, members = HEADER.unpack_from(data, HEADER_AT)
    return run_id, step, epoch, bird, stage, members


def stage_numbers(words: FloatArray, members: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return position, speed and circulation in `words`, each of shape (members,)."""
    position, speed, circulation = (
        words[at : at + members]
        for at in range(FIRST_WORD, FIRST_WORD + SEQUENCES * (members + 1), members + 1)
    )
    return position, speed, circulation
