# SPDX-License-Identifier: Apache-2.0
"""The installed message types, by their names in a bag, and the service types of the player."""

from __future__ import annotations

import re
from contextlib import suppress
from importlib import import_module
from typing import Any

from ament_index_python.resources import get_resource
from rclpy.type_support import NoTypeSupportImportedException, check_for_type_support

from flock_sim.bag.definitions import installed_definition
from flock_sim.errors import FlockError

INTERFACES = "rosidl_interfaces"
"""The resource of the ament index that lists the interfaces of a package."""

_NAME = re.compile(r"([a-z][a-z0-9_]*)/(?:msg/)?([A-Z][A-Za-z0-9]*)", re.ASCII)

_NOT_HERE = (ImportError, AttributeError, LookupError, OSError, NoTypeSupportImportedException)


def message_class(name: str) -> Any:
    """Return the class of the message type `name`, such as std_msgs/msg/String.

    Its package is imported only if the ament index lists the message, because a bag may name any
    Python module as a package. Raises ValueError if the type is not installed.
    """
    unknown = f"its type {name} can't be imported here"
    match = _NAME.fullmatch(name)
    if match is None:
        raise ValueError(unknown)
    package, kind = match.groups()
    try:
        listed, _ = get_resource(INTERFACES, package)
        if {f"msg/{kind}.idl", f"msg/{kind}.msg"}.isdisjoint(listed.split()):
            raise ValueError(unknown)
        found = getattr(import_module(f"{package}.msg"), kind)
        check_for_type_support(found)
    except _NOT_HERE as error:
        raise ValueError(unknown) from error
    return found


def service_class(name: str) -> Any:
    """Return the class of a service of rosbag2's player, such as Pause.

    It is that of rosbag2_interfaces where that is installed and has it, so that its clients can
    call the service, and otherwise the copy of flock_interfaces. A service name has one type only.
    """
    with suppress(*_NOT_HERE):
        found = getattr(import_module("rosbag2_interfaces.srv"), name)
        check_for_type_support(found)
        return found
    return getattr(import_module("flock_interfaces.srv"), name)


def installed_hash(name: str) -> str | None:
    """Return the hash of the installed definition of a type; None if it is not installed."""
    try:
        return installed_definition(name).type_hash
    except FlockError:
        return None
