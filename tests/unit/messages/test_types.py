# SPDX-License-Identifier: Apache-2.0
"""The bytes of every message follow its definition, and parts of them are read without decoding."""

import struct
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.configuration.perturbation import Perturbation, perturbations
from flock_sim.messages.cdr import Message
from flock_sim.messages.state import FRAME
from flock_sim.messages.types import (
    Checkpoint,
    Grant,
    Memory,
    Progress,
    Push,
    Stage,
    State,
    Time,
    Wing,
)
from support.random_messages import MESSAGES

# --- the layout, by hand: alignment counts from the end of the 4 bytes of encapsulation ---

CDR = b"\x00\x01\x00\x00"


def laid_out(*parts) -> bytes:
    """Bytes of (offset, format, values...) in order; gaps are zero. Offsets are by hand."""
    body = bytearray()
    for offset, layout, *values in parts:
        assert offset >= len(body), "parts overlap"
        body += bytes(offset - len(body))
        body += struct.pack("<" + layout, *values)
    return CDR + bytes(body)


def test_layout_of_a_wing():
    expected = laid_out((0, "Q", 7), (8, "I", 3), (12, "I", 2), (16, "2d", 1.0, 0.9))
    assert Wing(7, 3, np.array([1.0, 0.9])).encode() == expected


def test_layout_of_a_stage():
    message = Stage(
        7, 1000, 2, 13, 3, np.array([1.0, 2.0]), np.array([3.0, 4.0]), np.array([5.0, 6.0])
    )
    expected = laid_out(
        (0, "Q", 7),
        (8, "Q", 1000),
        (16, "I", 2),
        (20, "I", 13),
        (24, "B", 3),
        (28, "I", 2),
        (32, "2d", 1.0, 2.0),
        (48, "I", 2),
        (56, "2d", 3.0, 4.0),
        (72, "I", 2),
        (80, "2d", 5.0, 6.0),
    )
    assert message.encode() == expected


def test_layout_of_a_state():
    message = State(
        5,
        6,
        "flock",
        7,
        0.5,
        np.array([1.0]),
        np.array([2.0]),
        np.array([3.0]),
        np.array([4.0]),
        np.array([5.0]),
        np.array([6.0]),
        np.array([7.0, 8.0]),
        8,
        9,
    )
    expected = laid_out(
        (0, "i", 5),
        (4, "I", 6),
        (8, "I", 6),
        (12, "6s", b"flock\0"),
        (24, "Q", 7),
        (32, "d", 0.5),
        (40, "I", 1),
        (48, "d", 1.0),
        (56, "I", 1),
        (64, "d", 2.0),
        (72, "I", 1),
        (80, "d", 3.0),
        (88, "I", 1),
        (96, "d", 4.0),
        (104, "I", 1),
        (112, "d", 5.0),
        (120, "I", 1),
        (128, "d", 6.0),
        (136, "I", 2),
        (144, "2d", 7.0, 8.0),
        (160, "Q", 8),
        (168, "I", 9),
    )
    assert message.encode() == expected


def test_an_empty_sequence_is_its_length_and_no_padding():
    empty = np.array([])
    expected = laid_out(
        (0, "Q", 7), (8, "Q", 1), (16, "I", 2), (20, "I", 3), (24, "B", 0), (28, "3I", 0, 0, 0)
    )
    assert Stage(7, 1, 2, 3, 0, empty, empty, empty).encode() == expected


def test_layout_of_a_grant():
    expected = laid_out(
        (0, "Q", 7),
        (8, "Q", 64),
        (16, "Q", 10000),
        (24, "d", 0.25),
        (32, "I", 2),
        (36, "I", 6),
        (40, "6s", b"terms\0"),
        (48, "Q", 3),
    )
    assert Grant(7, 64, 10000, 0.25, 2, "terms", 3).encode() == expected


def test_layout_of_progress():
    expected = laid_out(
        (0, "Q", 7),
        (8, "q", -1),
        (16, "I", 2),
        (20, "I", 8),
        (24, "8s", b"bird_01\0"),
        (32, "Q", 5),
    )
    assert Progress(7, -1, 2, "bird_01", 5).encode() == expected


def test_layout_of_a_checkpoint():
    expected = laid_out(
        (0, "Q", 7),
        (8, "Q", 40),
        (16, "I", 2),
        (20, "I", 2),
        (24, "2d", 1.0, 2.0),
        (40, "I", 2),
        (48, "2d", 3.0, 4.0),
        (64, "I", 5),
        (68, "5s", b"text\0"),
        (76, "I", 1),
        (80, "d", 5.0),
        (88, "I", 1),
        (96, "d", 6.0),
    )
    message = Checkpoint(
        7,
        40,
        2,
        np.array([1.0, 2.0]),
        np.array([3.0, 4.0]),
        "text",
        np.array([5.0]),
        np.array([6.0]),
    )
    assert message.encode() == expected


def test_layout_of_the_checkpoint_of_a_start():
    expected = laid_out(
        (0, "Q", 7), (8, "Q", 0), (16, "I", 2), (20, "3I", 0, 0, 1), (32, "x"), (36, "2I", 0, 0)
    )
    assert Checkpoint.of_start(7, 2).encode() == expected


def test_layout_of_a_memory():
    expected = laid_out(
        (0, "Q", 7), (8, "Q", 40), (16, "I", 2), (20, "I", 13), (24, "I", 1), (32, "d", 5.0)
    )
    message = Memory(7, 40, 2, 13, np.array([5.0]))
    assert message.encode() == expected
    assert Memory.step_of(expected) == 40
    with pytest.raises(ValueError, match="too few"):
        Memory.step_of(expected[:19])


def test_layout_of_a_push():
    expected = laid_out(
        (0, "Q", 7), (8, "Q", 500), (16, "d", 0.1), (24, "d", -0.01), (32, "3I", 2, 4, 1)
    )
    assert Push(7, 500, 0.1, -0.01, 2, 4, 1).encode() == expected


def test_a_push_says_what_is_done():
    perturbation = Perturbation(step=500, bird=4, member=2, position=0.1, speed=-0.01)
    message = Push.of(7, 3, perturbation)
    assert (message.run_id, message.number, message.bird, message.member) == (7, 3, 4, 2)
    assert Push.decode(message.encode()).each(2) == [perturbation]
    assert str(message) == "4:2@500=0.1,-0.01"


def test_one_push_may_be_of_all_members():
    message = Push(7, 500, 0.1, -0.01, 3, 4, 0)
    assert [(push.member, push.bird) for push in message.each(3)] == [(1, 4), (2, 4), (3, 4)]
    assert list(perturbations([str(message)], 4, 3, 500)) == message.each(3)


def test_layout_of_the_clock():
    assert Time(3, 500).encode() == laid_out((0, "i", 3), (4, "I", 500))


def test_a_state_is_stamped_with_its_simulated_time():
    # Step 36 of dt = 1 is 36 / 24 s = 1.5 s: b / U_min is 1/24 s.
    one = np.ones(1)
    state = State.at(FlockConfiguration(), 36, *6 * [one])
    assert (state.seconds, state.nanoseconds, state.frame) == (1, 500_000_000, "world")
    assert (state.step, state.time) == (36, 36.0)


@given(stamp=st.integers(0, 2**31 * 10**9 - 1))
def test_clock_time_splits_into_seconds_and_nanoseconds(stamp):
    time = Time.at(stamp)
    assert 0 <= time.nanoseconds < 10**9
    assert time.stamp == stamp


@given(message=MESSAGES[State])
def test_the_step_of_an_encoded_state_is_read_without_decoding_it(message):
    framed = replace(message, frame=FRAME)  # as all are
    assert State.step_of(framed.encode()) == message.step


@given(message=MESSAGES[Stage])
def test_the_header_of_an_encoded_stage_is_read_without_decoding_it(message):
    data = message.encode()
    header = (message.run_id, message.step, message.epoch, message.bird, message.stage)
    assert Stage.header(data) == (*header, len(message.position))
    with pytest.raises(ValueError, match="31 bytes is too short"):
        Stage.header(data[:31])


@given(message=MESSAGES[State])
def test_run_and_epoch_of_an_encoded_state_are_read_and_taken_out_without_decoding_it(message):
    data = message.encode()
    assert State.envelope(data) == (message.run_id, message.epoch)
    assert State.opened(data) == replace(message, run_id=0, epoch=0).encode()


@given(message=MESSAGES[State])
def test_a_state_is_encoded_as_every_other_message(message):
    assert message.encode() == Message.encode(message)
    assert replace(message, frame="earth").encode() == Message.encode(
        replace(message, frame="earth")
    )


@pytest.mark.parametrize("members", [1, 2, 7])
@pytest.mark.parametrize("numbers", [0, 1, 3])
def test_a_state_of_a_flight_is_encoded_as_every_other_message(members, numbers):
    arrays = np.random.default_rng(members).standard_normal((6, members))
    forcing = np.arange(numbers * members, dtype=np.float64)
    state = State.at(FlockConfiguration(), 20, *arrays, forcing, 2**63, 2**32 - 1)
    assert state.encode() == Message.encode(state)


@pytest.mark.parametrize("members", [1, 2, 7])
def test_the_length_of_a_state_is_known_beforehand(members):
    some = np.ones(members)
    state = State.at(FlockConfiguration(), 0, *6 * [some])
    assert State.lengths(members).size == len(state.encode())
    assert State.lengths(members).unpack(state.encode()) == (*6 * (members,), 0)
    forced = replace(state, forcing_state=np.ones(3 * members)).encode()
    assert State.lengths(members, 3 * members).size == len(forced)
    assert State.lengths(members, 3 * members).unpack(forced) == (*6 * (members,), 3 * members)


@pytest.mark.parametrize("length", [0, 4, 27, 35])
def test_a_state_too_short_to_hold_a_step_is_refused(length):
    with pytest.raises(ValueError, match="BirdState"):
        State.step_of(bytes(length))
