# SPDX-License-Identifier: Apache-2.0
"""The compiled exchange of stages, in which birds in lockstep spend nearly all of the time.

It takes and sends messages by the same functions of rcl that rclpy calls. Through Python a message
costs some four times as much (docs/performance.md). It works on the words of a bird
(`protocol/stage_words.py`). The protocol and rclpy handle all exceptional cases.
"""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
from rclpy.publisher import Publisher
from rclpy.subscription import Subscription

from flock_sim.forcing.frame import FAULT
from flock_sim.messages.stage_layout import WORD
from flock_sim.physics.arrays import IntArray
from flock_sim.physics.compile import kernel
from flock_sim.physics.compiler import numba
from flock_sim.physics.native_call import ADDRESS, pointer
from flock_sim.physics.stage_kernels import ROWS, elements
from flock_sim.protocol.bird import BirdProtocol
from flock_sim.protocol.bird_kernel import OWN_ROWS, WORK_ROWS, feel_and_move
from flock_sim.protocol.stage_words import (
    EACH,
    END,
    EVERY,
    FIRST,
    FORCING,
    FORCING_WORDS,
    FOREIGN,
    HEARD,
    HERE,
    INCOMING,
    INTERACTIONS,
    LACKING,
    MEMBERS,
    MINE,
    NEIGHBOURS,
    OTHER_RUN,
    OUTGOING,
    OWN,
    PUBLISHER,
    SIDE,
    SUBSCRIPTION,
    TAKEN,
    TICK,
    WORK,
    accept,
    row,
    say,
    turn,
)

WAITS, OVER, STRANGE, FAILED, UNSENT, FAULTY = range(6)
"""Outcomes of an exchange: a message is lacking; the fast path is over; a message needs the
protocol; rcl could not take a message; rcl could not send the last message; a law of the forcing
has failed."""

NONE_CAME = 401  # RCL_RET_SUBSCRIPTION_TAKE_FAILED
ROOM = 512  # initial size of the buffer for a message, in bytes

# C functions that compiled code finds by name.
_take: Any = numba.types.ExternalFunction(
    "rcl_take_serialized_message", numba.types.int32(ADDRESS, ADDRESS, ADDRESS, ADDRESS)
)
_publish: Any = numba.types.ExternalFunction(
    "rcl_publish_serialized_message", numba.types.int32(ADDRESS, ADDRESS, ADDRESS)
)


class _Allocator(ctypes.Structure):
    """A rcutils_allocator_t."""

    _fields_ = [
        (name, ctypes.c_void_p)
        for name in ("allocate", "deallocate", "reallocate", "zero_allocate", "state")
    ]


class _Message(ctypes.Structure):
    """A rcl_serialized_message_t."""

    _fields_ = [
        ("buffer", ctypes.c_void_p),
        ("length", ctypes.c_size_t),
        ("capacity", ctypes.c_size_t),
        ("allocator", _Allocator),
    ]


BUFFER, LENGTH = 0, 1  # words of a message


@kernel
def exchange(words: IntArray, dt: float, thorough: bool) -> int:
    """Exchange stages as far as messages allow, up to the tick END; return the outcome.

    `words` are those of a bird, `dt` is the time step. A STRANGE message stays in the buffer of
    incoming messages. `thorough`: take all messages, also of neighbours not waited for.
    """
    members, count = words[MEMBERS], words[NEIGHBOURS]
    width = (row(words, MINE, 1) - row(words, MINE, 0)) // WORD
    own = numba.carray(pointer(words[OWN]), (OWN_ROWS, members), np.float64)
    shape = ROWS, elements(count * members)
    interactions = numba.carray(pointer(words[INTERACTIONS]), shape, np.float64)
    heard = numba.carray(pointer(words[HEARD]), (2, count, width), np.float64)
    mine = numba.carray(pointer(words[MINE]), (2, width), np.float64)
    work = numba.carray(pointer(words[WORK]), (WORK_ROWS, members), np.float64)
    forcing = numba.carray(pointer(words[FORCING]), words[FORCING_WORDS], np.int64)
    while words[TICK] < words[END]:
        for k in range(count):
            outcome = _hear(words, k, thorough)
            if outcome != WAITS:
                return outcome
        if words[LACKING + words[SIDE]]:
            return WAITS
        feel_and_move(words[TICK], dt, words[EVERY], own, interactions, heard, mine, work, forcing)
        if forcing.shape[0] > 0 and forcing[FAULT]:
            return FAULTY
        words[TICK] += 1
        turn(words, words[TICK] + 1)
        say(words)
        if _publish(words[PUBLISHER], words[OUTGOING + words[SIDE]], 0) != 0:
            return UNSENT
    return OVER


@kernel
def _hear(words: IntArray, k: int, thorough: bool) -> int:
    """Take messages of neighbour k until that of this tick is here, or all; return the outcome."""
    here = FIRST + EACH * k + HERE
    message = numba.carray(pointer(words[INCOMING]), 2, np.int64)
    while thorough or not words[here + words[SIDE]]:
        taken = _take(words[FIRST + EACH * k + SUBSCRIPTION], words[INCOMING], 0, 0)
        if taken == NONE_CAME:
            return WAITS
        if taken != 0:
            return FAILED
        outcome = accept(words, k, message[BUFFER], message[LENGTH])
        if outcome == OTHER_RUN:
            words[FOREIGN] += 1
        elif outcome != TAKEN:
            return STRANGE
    return WAITS


@cache
def available() -> bool:
    """Whether this ROS has these functions, so that compiled code can find them."""
    try:
        _library("librcl.so", "rcl_take_serialized_message", "rcl_publish_serialized_message")
        _incoming()
    except (OSError, AttributeError):
        return False
    return sys.byteorder == "little" and ctypes.sizeof(ctypes.c_size_t) == WORD


class CompiledExchange:
    """The compiled exchange of one bird, which continues where its protocol has stopped."""

    def __init__(
        self,
        protocol: BirdProtocol,
        dt: float,
        publisher: Publisher,
        inlets: Sequence[Subscription],
    ) -> None:
        """Connect `protocol` to rcl; `inlets` are for the stages of its neighbours.

        Use this object only until `publisher` or `inlets` are destroyed, and in one thread of the
        process: all birds take messages into the same buffer.
        """
        self._dt, self._words = dt, protocol.words
        self._outgoing = [_message(data) for data in protocol.outbox]  # at addresses in use
        self._words[PUBLISHER] = publisher.handle.pointer
        self._words[INCOMING] = ctypes.addressof(_incoming())
        self._words[OUTGOING : OUTGOING + 2] = list(map(ctypes.addressof, self._outgoing))
        self._words[FIRST + SUBSCRIPTION :: EACH] = [inlet.handle.pointer for inlet in inlets]

    def go_on(self) -> int:
        """Exchange stages while their messages are here; return the outcome: WAITS to FAULTY."""
        return exchange(self._words, self._dt, False)

    def look_through(self) -> int:
        """Do the same, but take messages of neighbours not waited for too."""
        return exchange(self._words, self._dt, True)


def compiled_exchange_of(
    protocol: BirdProtocol, dt: float, publisher: Publisher, inlets: Sequence[Subscription]
) -> CompiledExchange | None:
    """Return the compiled exchange of a bird; None if it is of no use, or ROS lacks functions."""
    if not (protocol.only_exchanges and available()):
        return None
    return CompiledExchange(protocol, dt, publisher, inlets)


def strange() -> bytes:
    """Return the message that caused the outcome STRANGE."""
    message = _incoming()
    return ctypes.string_at(message.buffer, message.length)


@cache
def _incoming() -> _Message:
    """Return the buffer for incoming messages of all birds here; ROS enlarges it as needed."""
    rcutils = _library("librcutils.so", "rcutils_get_default_allocator", "rcutils_uint8_array_init")
    rcutils.rcutils_get_default_allocator.restype = _Allocator
    rcutils.rcutils_uint8_array_init.argtypes = (
        *(ctypes.POINTER(_Message), ctypes.c_size_t, ctypes.POINTER(_Allocator)),
    )
    allocator, message = rcutils.rcutils_get_default_allocator(), _Message()
    if rcutils.rcutils_uint8_array_init(ctypes.byref(message), ROOM, ctypes.byref(allocator)):
        raise MemoryError(f"no room for a message of {ROOM} bytes")
    return message


def _message(data: memoryview) -> _Message:
    """Return a message to send that shares the memory of `data`."""
    message = _Message()
    message.buffer = ctypes.addressof(ctypes.c_char.from_buffer(data))
    message.length = message.capacity = len(data)
    return message


def _library(name: str, *functions: str) -> ctypes.CDLL:
    """Return a library that ROS has loaded, with its functions made visible to the process.

    Raises OSError if it is not loaded, and AttributeError if it lacks one of `functions`.
    """
    library = ctypes.CDLL(name, os.RTLD_NOLOAD | os.RTLD_GLOBAL)
    for function in functions:
        getattr(library, function)
    return library
