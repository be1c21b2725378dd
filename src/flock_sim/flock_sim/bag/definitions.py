# SPDX-License-Identifier: Apache-2.0
"""Message definitions for a bag, from the installed ROS packages.

Without ROS 2, a copy of the definitions of Flock's own messages, in `definitions.json`, is used.
The messages of a scene always have their definitions from there.
"""

import re
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from flock_sim.errors import FlockError
from flock_sim.outside import json_text

COPIES = Path(__file__).with_name("definitions.json")
"""The definitions of all types in bags of flights and scenes, by `tools/message_definitions.py`."""

_SEPARATOR = "=" * 80
_TYPE_NAME = re.compile(r"(\w+)/(?:msg/)?(\w+)", re.ASCII)
# The first word of a line is the field's type; comments begin with "#" and never match.
_FIELD_TYPE = re.compile(r"^[ \t]*([A-Za-z][\w/]*)", re.ASCII | re.MULTILINE)
_PRIMITIVES = frozenset(
    (
        *("bool", "byte", "char", "string", "wstring", "float32", "float64"),
        *("int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64"),
    )
)


@dataclass(frozen=True)
class Definition:
    """The definition of a message type in a bag.

    `text` is the ros2msg schema with every nested definition, `type_hash` the REP-2016 type
    description hash ("RIHS01_...").
    """

    type: str
    text: str
    type_hash: str


def installed_definition(type_name: str) -> Definition:
    """Look up a type such as "flock_interfaces/msg/BirdState" in the sourced workspace.

    Nested definitions follow the type's own text in the order and format of rosbag2: depth
    first, alphabetical within a type, each once, after a line of 80 "=" and "MSG: package/Type".

    Without ROS 2 it returns the copy of a type of Flock. Raises FlockError if the environment does
    not have the package or the type.
    """
    try:
        import ament_index_python  # noqa: F401
    except ImportError:
        if type_name in _copies():
            return _copies()[type_name]
        raise FlockError(
            f"message type {type_name} needs ROS 2, which is not installed here"
        ) from None
    return Definition(type_name, _text(type_name), _type_hash(type_name))


def copied_definition(type_name: str) -> Definition:
    """Return Flock's copy of a definition, which is the same on all machines.

    Raises KeyError for a type that neither a flight nor a scene has.
    """
    return _copies()[type_name]


@cache
def _copies() -> dict[str, Definition]:
    entries = json_text.parse(COPIES.read_text(encoding="utf-8"))
    return {entry["type"]: Definition(**entry) for entry in entries}


def _text(type_name: str) -> str:
    seen: set[str] = set()

    def with_nested(name: str) -> str:
        text = _read(name, ".msg")
        parts = [text]
        for nested in _nested_types(text, name.partition("/")[0]):
            if nested not in seen:
                seen.add(nested)
                parts.append(f"\n{_SEPARATOR}\nMSG: {nested}\n{with_nested(nested)}")
        return "".join(parts)

    return with_nested(type_name)


def _nested_types(text: str, package: str) -> list[str]:
    names = set(_FIELD_TYPE.findall(text)) - _PRIMITIVES
    return sorted(name if "/" in name else f"{package}/{name}" for name in names)


def _type_hash(type_name: str) -> str:
    try:
        for entry in json_text.parse(_read(type_name, ".json"))["type_hashes"]:
            if entry["type_name"] == type_name:
                return str(entry["hash_string"])
    except (ValueError, LookupError, TypeError) as error:
        raise FlockError(f"the type description of {type_name} is broken: {error!r}") from error
    raise FlockError(
        f"the type description of {type_name} has no hash of it: rebuild its package with Jazzy"
    )


def _read(type_name: str, suffix: str) -> str:
    match = _TYPE_NAME.fullmatch(type_name)
    if match is None:
        raise FlockError(f"message type {type_name!r} is not of the form package/msg/Type")
    package, name = match.groups()
    from ament_index_python.packages import get_package_share_directory

    try:
        # Imported here: bags are read without ROS, too.
        from ament_index_python.packages import get_package_share_directory

        share = get_package_share_directory(package, print_warning=False)
        return (Path(share) / "msg" / f"{name}{suffix}").read_text(encoding="utf-8")
    # The index raises LookupError for an unknown package, OSError without AMENT_PREFIX_PATH.
    except (ImportError, LookupError, ValueError, OSError) as error:
        raise FlockError(
            f"message type {type_name} is not installed (no {package}/msg/{name}{suffix} in"
            " AMENT_PREFIX_PATH): start through ./flock, or source install/setup.bash first"
        ) from error
