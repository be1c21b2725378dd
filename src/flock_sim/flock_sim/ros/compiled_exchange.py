# SPDX-License-Identifier: Apache-2.0
"""The compiled exchange of stages, in which birds in lockstep spend nearly all of the time.

It takes and sends messages by the same functions of rcl that rclpy calls. Through Python a message
costs some four times as much (docs/performance.md). The protocol and rclpy handle all exceptional
cases.
"""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Sequence
from functools import cache
from typing import Any

import numba
import numpy as np
from numba import types
from numba.core import cgutils
from numba.core.types import ExternalFunction
from numba.extending import intrinsic
from rclpy.publisher import Publisher
from rclpy.subscription import Subscription

from flock_sim.messages import stage_layout
from flock_sim.physics.arrays import IntArray
from flock_sim.physics.compile import kernel
from flock_sim.physics.runge_kutta import STAGES
from flock_sim.protocol.bird import BirdProtocol, Outgoing
from flock_sim.protocol.bird_kernel import WORK_ROWS, feel_and_move
from flock_sim.protocol.fast_path import (
    BEFORE,
    BIRD,
    EACH,
    END,
    EPOCH,
    FIRST,
    FOREIGN,
    GEOMETRY,
    HEADER,
    HEARD,
    HERE,
    INCOMING,
    MEMBERS,
    MINE,
    NAME,
    NEIGHBOURS,
    OUTGOING,
    OWN,
    PUBLISHER,
    RUN_ID,
    SIZE,
    SUBSCRIPTION,
    TICK,
    WORK,
    FastPath,
)

WAITS, MOVED, OVER, STRANGE, FAILED = range(5)
"""Outcomes of an exchange: a message is lacking; a message is lacking, after stages were flown; the
fast path is over; a message needs the protocol; rcl could not take a message."""

WORD = 8
HEADER_AT, HEADER_SIZE = stage_layout.HEADER_AT, stage_layout.HEADER.size
NONE_CAME = 401  # RCL_RET_SUBSCRIPTION_TAKE_FAILED
BEFORE_MESSAGE = 4  # bytes before a stored message, so that its numbers are aligned words
ROOM = 512  # initial size of the buffer for a message, in bytes

# C functions that compiled code finds by name.
_address: Any = types.intp
_take: Any = ExternalFunction(
    "rcl_take_serialized_message", types.int32(_address, _address, _address, _address)
)
_publish: Any = ExternalFunction(
    "rcl_publish_serialized_message", types.int32(_address, _address, _address)
)
_copy: Any = ExternalFunction("memcpy", _address(_address, _address, _address))


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


@intrinsic
def _pointer(_: Any, address: Any) -> Any:
    """Convert a number to an address."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.inttoptr(arguments[0], cgutils.voidptr_t)

    return types.voidptr(address), generate


@kernel
def _stride(path: IntArray) -> int:
    """Return the distance between stored stage messages, in bytes."""
    return BEFORE_MESSAGE + int(path[SIZE])


@kernel
def exchange(path: IntArray, dt: float, thorough: bool) -> int:
    """Continue a fast path as far as messages allow; return the outcome.

    `path` holds the words of a FastPath, `dt` is the time step. A STRANGE message stays in the
    buffer of incoming messages. `thorough`: take all messages, also of neighbours not waited for.
    """
    path[BEFORE] = path[TICK]
    members, count, width = path[MEMBERS], path[NEIGHBOURS], _stride(path) // WORD
    own = numba.carray(_pointer(path[OWN]), (6, members), np.float64)
    geometry = numba.carray(_pointer(path[GEOMETRY]), (count, 3, members), np.float64)
    heard = numba.carray(_pointer(path[HEARD]), (2, count, width), np.float64)
    mine = numba.carray(_pointer(path[MINE]), (2, width), np.float64)
    work = numba.carray(_pointer(path[WORK]), (WORK_ROWS, members), np.float64)
    outcome = WAITS
    while True:
        tick = path[TICK]
        side = tick & 1
        lacking = False
        for k in range(count):
            found = _hear(path, k, thorough)
            if found >= STRANGE:
                return found
            lacking |= found == WAITS
        if lacking:
            return outcome
        feel_and_move(tick, dt, own, geometry, heard, mine, work)
        for k in range(count):
            path[FIRST + EACH * k + HERE + side] = 0
        tick += 1
        path[TICK] = tick
        if tick >= path[END]:
            return OVER
        # The header begins with the second word of those that `feel_and_move` has filled.
        words = numba.carray(_pointer(path[MINE] + _stride(path) * (tick & 1)), width, np.int64)
        words[1] = path[RUN_ID]
        words[2] = tick // STAGES
        words[3] = path[EPOCH] | path[BIRD] << 32
        words[4] = tick % STAGES | members << 32
        if _publish(path[PUBLISHER], path[OUTGOING + (tick & 1)], 0) != 0:
            path[END] = tick
            return OVER
        outcome = MOVED


@kernel
def _hear(path: IntArray, k: int, thorough: bool) -> int:
    """Take messages of neighbour k until that of this tick has come; return MOVED if it has."""
    tick, members = path[TICK], path[MEMBERS]
    at = FIRST + EACH * k
    side = tick & 1
    message = numba.carray(_pointer(path[INCOMING]), 2, np.int64)
    while thorough or not path[at + HERE + side]:
        taken = _take(path[at + SUBSCRIPTION], path[INCOMING], 0, 0)
        if taken == NONE_CAME:
            return MOVED if path[at + HERE + side] else WAITS
        if taken != 0:
            return FAILED
        if message[LENGTH] != path[SIZE]:
            return STRANGE
        _copy(path.ctypes.data + WORD * HEADER, message[BUFFER] + HEADER_AT, HEADER_SIZE)
        if path[HEADER] != path[RUN_ID]:
            path[FOREIGN] += 1
            continue
        if path[HEADER + 2] != path[EPOCH] | path[at + NAME] << 32:
            return STRANGE
        said = STAGES * path[HEADER + 1] + (path[HEADER + 3] & 0xFF)
        place = said & 1
        if (
            not tick <= said <= tick + 1
            or path[HEADER + 1] != said // STAGES
            or path[HEADER + 3] != said % STAGES | members << 32
            or path[at + HERE + place]
        ):
            return STRANGE
        row = path[HEARD] + _stride(path) * (place * path[NEIGHBOURS] + k)
        _copy(row + BEFORE_MESSAGE, message[BUFFER], path[SIZE])
        path[at + HERE + place] = 1
    return MOVED


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
    """The compiled exchange of one bird: it enters the fast path, continues and leaves it."""

    def __init__(
        self,
        protocol: BirdProtocol,
        path: FastPath,
        dt: float,
        publisher: Publisher,
        inlets: Sequence[Subscription],
    ) -> None:
        """Fly `path`, that of `protocol`; `inlets` are for the stages of its neighbours.

        Use this object only until `publisher` or `inlets` are destroyed, and in one thread of the
        process: all birds take messages into the same buffer.
        """
        self.on = False
        """Whether the bird is on the fast path."""
        self._protocol, self._path, self._dt = protocol, path, dt
        self._words = path.words
        outgoing = [_message(data) for data in protocol.outbox]
        self._kept = outgoing  # they must live as long as their addresses are used
        path.connect(
            publisher.handle.pointer,
            ctypes.addressof(_incoming()),
            [ctypes.addressof(message) for message in outgoing],
            [inlet.handle.pointer for inlet in inlets],
        )

    def enter(self) -> bool:
        """Enter the fast path, unless the protocol has more to do; return whether it is on."""
        self.on = self.on or self._protocol.enter(self._path)
        return self.on

    def go_on(self) -> int:
        """Continue the fast path; return the outcome: WAITS to FAILED."""
        return exchange(self._words, self._dt, False)

    def look_through(self) -> int:
        """Do the same, but take messages of neighbours not waited for too."""
        return exchange(self._words, self._dt, True)

    @property
    def moved(self) -> bool:
        """Whether the last call flew a stage."""
        return self._path.moved

    @property
    def foreign(self) -> bool:
        """Whether messages of other runs came; `leave` counts them."""
        return self._path.foreign > 0

    def leave(self) -> list[Outgoing]:
        """Leave the fast path; return the messages that the protocol sends."""
        self.on = False
        return self._protocol.leave(self._path)


def compiled_exchange_of(
    protocol: BirdProtocol, dt: float, publisher: Publisher, inlets: Sequence[Subscription]
) -> CompiledExchange | None:
    """Return the compiled exchange of a bird; None without a fast path or the rcl functions."""
    path = protocol.fast_path() if available() else None
    return CompiledExchange(protocol, path, dt, publisher, inlets) if path else None


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
