# SPDX-License-Identifier: Apache-2.0
"""Every message is read back as it was written, and is refused when its bytes are broken."""

import struct
import tracemalloc
from dataclasses import fields
from math import inf, nan

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from flock_sim.messages.cdr import Message
from flock_sim.messages.types import Grant, Progress, Wing
from support.random_messages import MESSAGES

messages = st.one_of(*MESSAGES.values())
KINDS = [pytest.param(kind, id=kind.__name__) for kind in MESSAGES]


def same(one, other) -> bool:
    """Whether two values are equal, numbers to the bit (nan included)."""
    if isinstance(one, np.ndarray):
        return one.tobytes() == np.asarray(other, dtype=np.float64).tobytes()
    if isinstance(one, float):
        return struct.pack("<d", one) == struct.pack("<d", other)
    return one == other and type(one) is type(other)


def assert_same(one: Message, other: Message) -> None:
    assert type(one) is type(other)
    for field in fields(one):
        assert same(getattr(one, field.name), getattr(other, field.name)), field.name


@given(message=messages)
@example(message=Wing(7, 1, np.array([nan, inf, -inf, -0.0, 5e-324])))
def test_what_is_written_is_read_back(message):
    data = message.encode()
    assert_same(message, type(message).decode(data))
    assert type(message).decode(data).encode() == data


@given(message=messages)
def test_the_place_of_a_field_is_where_its_first_bytes_are(message):
    data = message.encode()
    for field, kind in zip(fields(message), message.KINDS, strict=True):
        value = getattr(message, field.name)
        if kind == "text":
            kind, value = "I", len(value.encode()) + 1
        elif kind == "numbers":
            kind, value = "I", len(value)
        (found,) = struct.unpack_from("<" + kind, data, message.place(field.name))
        assert same(found, value), field.name
    with pytest.raises(KeyError):
        message.place("none of its fields")


@given(message=messages)
def test_any_buffer_of_bytes_will_do(message):
    data = message.encode()
    for buffer in (bytearray(data), memoryview(data)):
        assert_same(message, type(message).decode(buffer))


@given(message=messages, spare=st.binary(max_size=8))
def test_padding_after_a_message_is_left_alone(message, spare):
    # Middleware may pad what it sends to a multiple of four bytes.
    assert_same(message, type(message).decode(message.encode() + spare))


@given(message=messages, data=st.data())
def test_a_message_cut_short_is_refused(message, data):
    whole = message.encode()
    cut = data.draw(st.integers(0, len(whole) - 1))
    with pytest.raises(ValueError, match=r"flock_interfaces/msg/|rosgraph_msgs/msg/Clock"):
        type(message).decode(whole[:cut])


def decoded_or_refused(kind: type[Message], data: bytes) -> None:
    """Decode, letting ValueError through as the one way to refuse, and watch the memory."""
    tracemalloc.start()
    try:
        kind.decode(data)
    except ValueError:
        pass
    finally:
        _, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
    # Decoded arrays are views; text is copied once or twice. Python's own objects are small.
    assert peak < 64 * 1024 + 8 * len(data)


@pytest.mark.parametrize("kind", KINDS)
@given(data=st.binary(max_size=200))
def test_garbage_is_refused_with_value_error_or_read_in_little_memory(kind, data):
    decoded_or_refused(kind, data)
    decoded_or_refused(kind, b"\x00\x01\x00\x00" + data)


@given(message=messages, data=st.data())
def test_corrupt_bytes_are_refused_with_value_error_or_read_in_little_memory(message, data):
    broken = bytearray(message.encode())
    for _ in range(data.draw(st.integers(1, 4))):
        broken[data.draw(st.integers(0, len(broken) - 1))] = data.draw(st.integers(0, 255))
    decoded_or_refused(type(message), bytes(broken))


@pytest.mark.parametrize("length", [2**32 - 1, 2**31, 2**29, 1000])
def test_a_sequence_longer_than_its_message_is_refused(length):
    data = bytearray(Wing(7, 1, np.ones(3)).encode())
    data[16:20] = struct.pack("<I", length)
    with pytest.raises(ValueError, match="BirdWing"):
        Wing.decode(bytes(data))


@pytest.mark.parametrize("length", [2**32 - 1, 1000, 10])
def test_a_text_longer_than_its_message_is_refused(length):
    data = bytearray(Progress(7, 1, 1, "bird_01").encode())
    data[24:28] = struct.pack("<I", length)
    with pytest.raises(ValueError, match="Progress"):
        Progress.decode(bytes(data))


def test_text_that_is_not_utf_8_is_refused():
    data = Progress(7, 1, 1, "bird_01").encode().replace(b"bird", b"\xff\xfe\xfd\xfc")
    with pytest.raises(ValueError, match="Progress"):
        Progress.decode(data)


@pytest.mark.parametrize("header", [b"\x00\x00\x00\x00", b"\x00\x03\x00\x00", b"", b"\x00\x01"])
def test_other_encapsulations_are_refused(header):
    data = Grant(7, 1, 2, 1.0, 1).encode()
    with pytest.raises(ValueError, match="not little-endian CDR"):
        Grant.decode(header + data[4:] if len(header) == 4 else header)
