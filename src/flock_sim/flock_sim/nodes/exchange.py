# SPDX-License-Identifier: Apache-2.0
"""The exchange of stages, compiled: what birds in lockstep do nearly all of the time.

Messages are taken and sent by the functions of rcl that rclpy calls, too; by way of Python a
message costs some four times as much (docs/performance.md). Whatever is out of the ordinary is left
to the protocol and rclpy.
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

from flock_sim.core import stage_message
from flock_sim.core.bird_step import WORK_ROWS, feel_and_move
from flock_sim.core.kernel import IntArray, kernel
from flock_sim.core.leg import (
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
    Leg,
)
from flock_sim.core.protocol import BirdProtocol, Outgoing
from flock_sim.core.runge_kutta import STAGES

WAITS, MOVED, OVER, STRANGE, FAILED = range(5)
"""What came of an exchange: a message is still lacking; the same, after stages; the leg is over;
there is a message that the protocol has to judge; ROS could not take or send, and can say why."""

WORD = 8
HEADER_AT, HEADER_SIZE = stage_message.HEADER_AT, stage_message.HEADER.size
NONE_CAME = 401  # RCL_RET_SUBSCRIPTION_TAKE_FAILED
BEFORE_MESSAGE = 4  # bytes before a message that is kept: so its numbers are aligned words
ROOM = 512  # of a message, in bytes, to begin with

# C functions, which compiled code finds by their names.
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
    """Take a number for an address."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.inttoptr(arguments[0], cgutils.voidptr_t)

    return types.voidptr(address), generate


@kernel
def _stride(leg: IntArray) -> int:
    """Return the bytes from one stage message to the next, where they are kept."""
    return BEFORE_MESSAGE + leg[SIZE]


@kernel
def exchange(leg: IntArray, dt: float, thorough: bool) -> int:
    """Go on along a leg as far as messages allow; return what came of it.

    `leg` are the words of a Leg, `dt` is the time step. A STRANGE message is in what the leg takes
    messages into. `thorough`: take all that is there, also of who is not waited for.
    """
    leg[BEFORE] = leg[TICK]
    members, count, width = leg[MEMBERS], leg[NEIGHBOURS], _stride(leg) // WORD
    own = numba.carray(_pointer(leg[OWN]), (6, members), np.float64)
    geometry = numba.carray(_pointer(leg[GEOMETRY]), (count, 3, members), np.float64)
    heard = numba.carray(_pointer(leg[HEARD]), (2, count, width), np.float64)
    mine = numba.carray(_pointer(leg[MINE]), (2, width), np.float64)
    work = numba.carray(_pointer(leg[WORK]), (WORK_ROWS, members), np.float64)
    outcome = WAITS
    while True:
        tick = leg[TICK]
        side = tick & 1
        lacking = False
        for k in range(count):
            found = _hear(leg, k, thorough)
            if found >= STRANGE:
                return found
            lacking |= found == WAITS
        if lacking:
            return outcome
        feel_and_move(tick, dt, own, geometry, heard, mine, work)
        for k in range(count):
            leg[FIRST + EACH * k + HERE + side] = 0
        tick += 1
        leg[TICK] = tick
        if tick >= leg[END]:
            return OVER
        # The header begins with the second word of those that `feel_and_move` has filled.
        words = numba.carray(_pointer(leg[MINE] + _stride(leg) * (tick & 1)), width, np.int64)
        words[1] = leg[RUN_ID]
        words[2] = tick // STAGES
        words[3] = leg[EPOCH] | leg[BIRD] << 32
        words[4] = tick % STAGES | members << 32
        if _publish(leg[PUBLISHER], leg[OUTGOING + (tick & 1)], 0) != 0:
            leg[END] = tick
            return OVER
        outcome = MOVED


@kernel
def _hear(leg: IntArray, k: int, thorough: bool) -> int:
    """Take messages of neighbour k until that of this tick is here; return MOVED if it is."""
    tick, members = leg[TICK], leg[MEMBERS]
    at = FIRST + EACH * k
    side = tick & 1
    message = numba.carray(_pointer(leg[INCOMING]), 2, np.int64)
    while thorough or not leg[at + HERE + side]:
        taken = _take(leg[at + SUBSCRIPTION], leg[INCOMING], 0, 0)
        if taken == NONE_CAME:
            return MOVED if leg[at + HERE + side] else WAITS
        if taken != 0:
            return FAILED
        if message[LENGTH] != leg[SIZE]:
            return STRANGE
        _copy(leg.ctypes.data + WORD * HEADER, message[BUFFER] + HEADER_AT, HEADER_SIZE)
        if leg[HEADER] != leg[RUN_ID]:
            leg[FOREIGN] += 1
            continue
        if leg[HEADER + 2] != leg[EPOCH] | leg[at + NAME] << 32:
            return STRANGE
        said = STAGES * leg[HEADER + 1] + (leg[HEADER + 3] & 0xFF)
        place = said & 1
        if (
            not tick <= said <= tick + 1
            or leg[HEADER + 1] != said // STAGES
            or leg[HEADER + 3] != said % STAGES | members << 32
            or leg[at + HERE + place]
        ):
            return STRANGE
        row = leg[HEARD] + _stride(leg) * (place * leg[NEIGHBOURS] + k)
        _copy(row + BEFORE_MESSAGE, message[BUFFER], leg[SIZE])
        leg[at + HERE + place] = 1
    return MOVED


@cache
def available() -> bool:
    """Whether this ROS has these functions, for compiled code to find."""
    try:
        _library("librcl.so", "rcl_take_serialized_message", "rcl_publish_serialized_message")
        _incoming()
    except (OSError, AttributeError):
        return False
    return sys.byteorder == "little" and ctypes.sizeof(ctypes.c_size_t) == WORD


class Legs:
    """The legs of one bird: it embarks, goes on, and lands to be asked for anything."""

    def __init__(
        self,
        protocol: BirdProtocol,
        leg: Leg,
        dt: float,
        publisher: Publisher,
        inlets: Sequence[Subscription],
    ) -> None:
        """Fly `leg`, that of `protocol`; `inlets` are for the stages of its neighbours.

        They are for as long as `publisher` and `inlets` are not destroyed, and for one thread of
        the process: all birds take messages into the same place.
        """
        self.on = False
        """Whether it is on a leg."""
        self._protocol, self._leg, self._dt = protocol, leg, dt
        self._words = leg.words
        outgoing = [_message(data) for data in protocol.outbox]
        self._kept = outgoing  # as long as their addresses are
        leg.connect(
            publisher.handle.pointer,
            ctypes.addressof(_incoming()),
            [ctypes.addressof(message) for message in outgoing],
            [inlet.handle.pointer for inlet in inlets],
        )

    def embark(self) -> bool:
        """Be on a leg, unless the protocol has more to do; return whether it is."""
        self.on = self.on or self._protocol.embark(self._leg)
        return self.on

    def go_on(self) -> int:
        """Go on along the leg; return what comes of it, one of those above."""
        return exchange(self._words, self._dt, False)

    def look_through(self) -> int:
        """Do the same, and take what comes from those who are not waited for, too."""
        return exchange(self._words, self._dt, True)

    @property
    def moved(self) -> bool:
        """Whether a stage was flown the last time."""
        return self._leg.moved

    @property
    def foreign(self) -> bool:
        """Whether messages of other runs came, which are counted when it lands."""
        return self._leg.foreign > 0

    def land(self) -> list[Outgoing]:
        """Leave the leg to the protocol; return what that says."""
        self.on = False
        return self._protocol.land(self._leg)


def legs_of(
    protocol: BirdProtocol, dt: float, publisher: Publisher, inlets: Sequence[Subscription]
) -> Legs | None:
    """Return the legs of a bird; None if it has none, or this ROS has not what they need."""
    leg = protocol.leg() if available() else None
    return Legs(protocol, leg, dt, publisher, inlets) if leg else None


def strange() -> bytes:
    """Return the message that was found STRANGE."""
    message = _incoming()
    return ctypes.string_at(message.buffer, message.length)


@cache
def _incoming() -> _Message:
    """Return what all birds of this process take messages into; ROS makes it larger as needed."""
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
    """Return `data`, which stays where it is, as a message to be sent."""
    message = _Message()
    message.buffer = ctypes.addressof(ctypes.c_char.from_buffer(data))
    message.length = message.capacity = len(data)
    return message


def _library(name: str, *functions: str) -> ctypes.CDLL:
    """Return a library that ROS has loaded, its functions for all to find.

    Raises OSError where there is none, AttributeError where it has not these functions.
    """
    library = ctypes.CDLL(name, os.RTLD_NOLOAD | os.RTLD_GLOBAL)
    for function in functions:
        getattr(library, function)
    return library
