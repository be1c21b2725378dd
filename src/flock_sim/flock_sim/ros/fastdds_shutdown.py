# SPDX-License-Identifier: Apache-2.0
"""Shutdown of Fast DDS 2 without a deadlock.

The end of a participant of Fast DDS 2 may hang for ever, in a busy loop, if another thread
notifies it of other participants, for example of their ends (eProsima/Fast-DDS issue 6513). ROS
removes its listener without a time limit. Fast DDS then waits until the last time point of its
clock, which overflows, and never releases the lock that the other thread needs to finish. With a
limit it waits correctly. So we remove the listener, with a limit, before ROS does. Then ROS has
nothing left to wait for.

The Python of ROS has no access to this, so the functions are called by their names in the library.
If the library lacks one of these names (Fast DDS 3 is another library), nothing is done.
"""

from __future__ import annotations

import ctypes
import os
import re
from collections.abc import Iterable
from functools import cache
from pathlib import Path

from rclpy.context import Context
from rclpy.node import Node

LIMIT = 10
"""Longest wait for the other thread, in s; it needs some microseconds."""

LIBRARY = re.compile(rb"^(?:\S+ +){5}(/.*/libfastrtps\.so[^/\n]*?)(?: \(deleted\))?$", re.MULTILINE)
"""A line of /proc/self/maps: five fields, then the path, which may have spaces."""

_DDS = "8eprosima7fastdds3dds"
GET_FACTORY = f"_ZN{_DDS}24DomainParticipantFactory12get_instanceEv"
LOOK_UP = f"_ZNK{_DDS}24DomainParticipantFactory19lookup_participantsEj"
SET_LISTENER = (
    f"_ZN{_DDS}17DomainParticipant12set_listenerEPNS1_25DomainParticipantListenerE"
    "NSt6chrono8durationIlSt5ratioILl1ELl1EEEE"
)


class _Vector(ctypes.Structure):
    """A std::vector of pointers."""

    _fields_ = (
        ("begin", ctypes.POINTER(ctypes.c_void_p)),
        ("end", ctypes.c_void_p),
        ("capacity", ctypes.c_void_p),
    )


def leave(context: Context, nodes: Iterable[Node]) -> None:
    """Destroy `nodes` of `context`, which include the last ones of its process on its domain."""
    stop_discovery(context)
    for node in nodes:
        node.destroy_node()


def stop_discovery(context: Context) -> None:
    """Stop notifying the participants of this process, on the domain of `context`, of others.

    Call this before the last node is destroyed. Messages still arrive after it.
    """
    if not context.ok() or (library := fast_dds()) is None:
        return
    factory = library[GET_FACTORY]
    factory.restype = ctypes.c_void_p
    look_up = library[LOOK_UP]
    look_up.argtypes, look_up.restype = (ctypes.c_void_p, ctypes.c_uint32), _Vector
    set_listener = library[SET_LISTENER]
    set_listener.argtypes = (ctypes.c_void_p, ctypes.c_void_p, ctypes.c_int64)
    found = look_up(factory(), context.get_domain_id())
    if not found.begin:
        return
    begin = ctypes.addressof(found.begin.contents)
    for index in range((found.end - begin) // ctypes.sizeof(ctypes.c_void_p)):
        set_listener(found.begin[index], None, LIMIT)


@cache
def fast_dds() -> ctypes.CDLL | None:
    """Return the Fast DDS library of this process, or None if it has no known version."""
    try:
        if (path := library_in(Path("/proc/self/maps").read_bytes())) is None:
            return None
        library = ctypes.CDLL(path, os.RTLD_NOLOAD)  # a second copy would know no participants
    except OSError:
        return None
    return (
        library if all(hasattr(library, n) for n in (GET_FACTORY, LOOK_UP, SET_LISTENER)) else None
    )


def library_in(maps: bytes) -> str | None:
    """Return the path of the mapped Fast DDS library, from the text of /proc/self/maps."""
    match = LIBRARY.search(maps)
    return os.fsdecode(match[1]) if match else None
