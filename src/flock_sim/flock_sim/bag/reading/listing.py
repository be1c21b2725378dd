# SPDX-License-Identifier: Apache-2.0
"""The list of a bag's files, from its metadata.yaml, or from its directory without one."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from flock_sim.bag.directory import METADATA_FILE, is_recording
from flock_sim.bag.reading.compression import FORMAT
from flock_sim.bag.reading.other_formats import SQLITE, conversion, format_of_name
from flock_sim.errors import FlockError

# The list of topics: for hundreds of topics its parsing takes seconds, and the files have it too.
_TOPICS = re.compile(r"^( +)topics_with_message_count:.*\n(?:\1[ -].*\n|[ \t]*\n)*", re.MULTILINE)

_INFORMATION = "rosbag2_bagfile_information"
_DEEPEST = 32
"""Deepest nesting of lists and mappings; rosbag2 nests six."""


@dataclass(frozen=True)
class Listing:
    """The files of a bag in order.

    `packed_messages`: the data of every message is compressed. `missing`: the missing parts of the
    bag. `left_out`: the files in its directory that are no part of it.
    """

    files: list[Path]
    packed_messages: bool = False
    missing: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()


def listing(path: Path) -> Listing:
    """Find the files of a bag directory, or one file; raises FlockError if there is none."""
    try:
        if not path.is_dir():
            return _single(path)
        entries = sorted(path.iterdir())
    except OSError as error:
        raise FlockError(f"{path} can't be read: {error.strerror}") from error
    found = [entry for entry in entries if is_recording(_plain(entry.name))]
    names = {file.name for file in found}
    found = [
        file for file in found if file.name == _plain(file.name) or _plain(file.name) not in names
    ]
    if not found:
        why = "there is no .mcap file in it"
        others = [entry for entry in entries if format_of_name(_plain(entry.name))]
        if others and (what := format_of_name(_plain(others[0].name))):
            # Of ROS 1, each file is a bag.
            bag = path if what == SQLITE else others[0]
            why = f"it has {what} ({others[0].name}): {conversion(what, bag)}"
        raise FlockError(f"{path} is not a bag that can be read: {why}")
    if not (path / METADATA_FILE).exists():
        missing = f"no {METADATA_FILE} (the recording was cut short)"
        return Listing(_in_order(found), missing=(missing,))
    information = _information(path)
    if information is None:
        return Listing(_in_order(found), missing=(f"{METADATA_FILE} can't be read",))
    return _listed(path, information, found)


def packed_as_recorded(path: Path, record: Mapping[str, str]) -> bool:
    """Whether rosbag2's metadata record in a file says that its messages are compressed.

    Raises FlockError if they are compressed in a way that can't be read.
    """
    information = _parsed(record.get("serialized_metadata", ""))
    return information is not None and _packed(information, path)


def _single(path: Path) -> Listing:
    """Return one file; it is compressed like its bag if the metadata.yaml beside it lists it."""
    information = _information(path.parent) or {}
    return Listing([path], path.name in _names(information) and _packed(information, path))


def _listed(path: Path, information: Mapping[str, Any], found: list[Path]) -> Listing:
    """Return the existing files of those that metadata.yaml lists."""
    by_name = {file.name: file for file in found}
    files: list[Path] = []
    missing: list[str] = []
    for name in _names(information):
        # An unpacked copy of the file serves as well.
        file = by_name.get(name) or by_name.get(_plain(name))
        if file is None:
            missing.append(f"{name if name.isprintable() else repr(name)} is not there")
        else:
            files.append(file)
    packed = _packed(information, path)
    if not files:  # all files were renamed
        return Listing(_in_order(found), packed, tuple(missing))
    read = {_plain(file.name) for file in files}
    others = [file.name for file in found if _plain(file.name) not in read]
    return Listing(list(dict.fromkeys(files)), packed, tuple(missing), tuple(others))


def _information(directory: Path) -> Mapping[str, Any] | None:
    """Return the content of metadata.yaml except its topics; None if it can't be read."""
    try:
        return _parsed((directory / METADATA_FILE).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None


def _parsed(text: str) -> Mapping[str, Any] | None:
    """Return the content of a metadata.yaml, with all values as texts; None if it is invalid."""
    try:
        document = _tree(_TOPICS.sub("", text))
    except (ValueError, yaml.YAMLError):
        return None
    information = document.get(_INFORMATION) if isinstance(document, dict) else None
    return information if isinstance(information, dict) else None


def _tree(text: str) -> Any:
    """Return a YAML document as lists, mappings and texts. Raises ValueError, yaml.YAMLError.

    It is built from YAML events, since libyaml's loader recurses until the process crashes.
    """
    open_ones: list[list[Any]] = [[]]
    for event in yaml.parse(text, Loader=yaml.CBaseLoader):
        if isinstance(event, yaml.CollectionStartEvent):
            open_ones.append([])
            if len(open_ones) > _DEEPEST:
                raise ValueError("it is nested too deeply")
        elif isinstance(event, yaml.ScalarEvent):
            open_ones[-1].append(event.value)
        elif isinstance(event, yaml.AliasEvent):
            open_ones[-1].append(None)  # no needed value is an alias
        elif isinstance(event, yaml.SequenceEndEvent):
            items = open_ones.pop()
            open_ones[-1].append(items)
        elif isinstance(event, yaml.MappingEndEvent):
            items = open_ones.pop()
            pairs = zip(items[::2], items[1::2], strict=True)
            open_ones[-1].append({key: value for key, value in pairs if isinstance(key, str)})
    return open_ones[0][0] if open_ones[0] else None


def _names(information: Mapping[str, Any]) -> list[str]:
    """Return the names of the files of a bag, each once."""
    listed = information.get("relative_file_paths")
    # The name only: older rosbag2 puts the directory before it; no path may leave this directory.
    names = [Path(str(name)).name for name in listed] if isinstance(listed, list) else []
    return list(dict.fromkeys(names))


def _packed(information: Mapping[str, Any], path: Path) -> bool:
    """Whether the data of every message is compressed; raises FlockError if it can't be read."""
    if str(information.get("compression_mode")).upper() != "MESSAGE":
        return False
    if (form := information.get("compression_format")) != FORMAT:
        raise FlockError(
            f"{path}: its messages are compressed as {form!r}, not as {FORMAT}: write it without"
            " compression with ros2 bag convert"
        )
    return True


def _plain(name: str) -> str:
    return name.removesuffix(f".{FORMAT}")


def _in_order(files: list[Path]) -> list[Path]:
    # rosbag2 splits a long bag into NAME_0.mcap, NAME_1.mcap, ... NAME_10.mcap
    return sorted(files, key=lambda file: (_number(file.name), file.name))


def _number(name: str) -> int:
    match = re.search(r"_(\d+)\.mcap", name)
    return int(match[1]) if match else 0
