# SPDX-License-Identifier: Apache-2.0
"""The in-place layout of a stage message is the BirdStage that others decode."""

import numpy as np
import pytest

from flock_sim.messages.stage_layout import (
    HEADER,
    HEADER_AT,
    HEADER_WORD,
    HEADER_WORDS,
    stage_bytes,
    stage_numbers,
    stage_words,
)
from flock_sim.messages.types import Stage
from flock_sim.protocol.stage_words import has_header, put_header


def lying(members: int) -> tuple[np.ndarray, memoryview]:
    """Words of a message whose numbers are 1, 2, 3 ... in the order they travel, and its bytes."""
    words = np.zeros(stage_words(members))
    data = stage_bytes(words, members)
    for k, numbers in enumerate(stage_numbers(words, members)):
        numbers[:] = 1.0 + k * members + np.arange(members)
    header = words.view(np.int64)[HEADER_WORD : HEADER_WORD + HEADER_WORDS]
    put_header(header, 7, 4003, 2, 13, members)
    assert has_header(header, 7, 4003, 2, 13, members)
    return words, data


@pytest.mark.parametrize("members", [1, 2, 3, 50])
def test_the_bytes_are_those_of_the_encoded_message(members):
    words, data = lying(members)
    position, speed, circulation = np.split(1.0 + np.arange(3 * members), 3)
    message = Stage(7, 1000, 2, 13, 3, position, speed, circulation)
    assert bytes(data) == message.encode()
    for lies, sent in zip(stage_numbers(words, members), (position, speed, circulation)):
        np.testing.assert_array_equal(lies, sent)


@pytest.mark.parametrize("field", range(5))
def test_a_header_is_told_from_any_other(field):
    words, _ = lying(2)
    other = [7, 4003, 2, 13, 2]
    other[field] += 1
    header = words.view(np.int64)[HEADER_WORD : HEADER_WORD + HEADER_WORDS]
    assert not has_header(header, *other)


def test_the_header_is_laid_out_as_the_message_definition_says():
    assert HEADER.unpack(HEADER.pack(2**64 - 1, 0, 0, 2**32 - 1, 255, 1))[3:] == (2**32 - 1, 255, 1)
    assert (HEADER_AT, HEADER.size) == (4, 32)


def test_bytes_and_numbers_are_the_same_memory():
    words, data = lying(2)
    position, _, circulation = stage_numbers(words, 2)
    one = np.ones(2)
    data[:] = Stage(7, 1001, 2, 13, 0, 5.0 * one, one, 6.0 * one).encode()
    assert (position.tolist(), circulation.tolist()) == ([5.0, 5.0], [6.0, 6.0])


def test_the_header_is_read_without_decoding_the_message():
    _, data = lying(2)
    assert Stage.header(bytes(data)) == (7, 1000, 2, 13, 3, 2)


@pytest.mark.parametrize("length", [0, 4, HEADER_AT + HEADER.size - 1])
def test_a_message_too_short_for_a_header_is_refused(length):
    with pytest.raises(ValueError, match=f"{length} bytes is too short"):
        Stage.header(bytes(length))
