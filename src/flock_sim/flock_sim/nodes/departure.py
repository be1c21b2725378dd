# SPDX-License-Identifier: Apache-2.0
"""Leaving DDS without being caught in it.

Who ends a participant of Fast DDS 2 while another thread tells it of others, say of their ends, may
wait for ever, at full speed (eProsima/Fast-DDS issue 6513): ROS takes its listener away without a
time limit, Fast DDS waits until the last moment that a clock can show, which overflows, and never
lets go of the lock that the other thread needs to be done. With a limit it waits as it should. So
we take the listener away, with one, before ROS does; nothing is left to wait for then.

None of this is in the Python of ROS, so the functions are called by their names in the library.
Where it has none of these names (Fast DDS 3 is another library), nothing is done.
"""

from __future__ import annotations

import ctypes
import re
from collections.abc import Iterable
from functools import cache
from pathlib import Path

from rclpy.context import Context
from rclpy.node import Node

LIMIT = 10
"""Time, in s, in which the other thread will be done; it takes some microseconds."""

LIBRARY = re.compile(r"/\S*/libfastrtps\.so\S*")

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
    """Destroy `nodes` of `context`, among them the last that its process has on this domain."""
    stop_discovery(context)
    for node in nodes:
        node.destroy_node()


def stop_discovery(context: Context) -> None:
    """Tell the participants of this process on the domain of `context` of nobody any more.

    To be called before the last node is destroyed. What others say is heard all the same.
    """
    if not context.ok() or (library := _fast_dds()) is None:
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
def _fast_dds() -> ctypes.CDLL | None:
    """Return the Fast DDS that this process uses, or None where it uses none that we know."""
    try:
        maps = Path("/proc/self/maps").read_text(encoding="utf-8")
    except OSError:
        return None
    if not (match := LIBRARY.search(maps)):
        return None
    library = ctypes.CDLL(match[0])
    return (
        library if all(hasattr(library, n) for n in (GET_FACTORY, LOOK_UP, SET_LISTENER)) else None
    )
