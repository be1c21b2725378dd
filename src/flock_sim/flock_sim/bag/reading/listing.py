# SPDX-License-Identifier: Apache-2.0
"""The list of a bag's files, from its metadata.yaml, or from its directory without one."""

import os
import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from flock_sim.bag import limits
from flock_sim.bag.directory import METADATA_FILE, is_recording
from flock_sim.bag.reading.compression import FORMAT
from flock_sim.bag.reading.other_formats import SQLITE, conversion, format_of_name
from flock_sim.errors import FlockError
from flock_sim.outside import yaml_text
from flock_sim.outside.regular_file import read_file

# The list of topics: for hundreds of topics its parsing takes seconds, and the files have it too.
_TOPICS = re.compile(r"^( +)topics_with_message_count:.*\n(?:\1[ -].*\n|[ \t]*\n)*", re.MULTILINE)

_INFORMATION = "rosbag2_bagfile_information"


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
        entries = os.listdir(path)  # names: a directory may have millions of other files
    except OSError as error:
        raise FlockError(f"{path} can't be read: {error.strerror}") from error
    names = {name for name in entries if is_recording(_plain(name))}
    if len(names) > limits.MOST_FILES:
        what = limits.beyond(len(names), limits.MOST_FILES, "files of bags")
        raise FlockError(f"{path} has {what}: name a directory with one bag")
    chosen = sorted(name for name in names if name == _plain(name) or _plain(name) not in names)
    found = [path / name for name in chosen]
    if not found:
        why = "there is no .mcap file in it"
        other = min((name for name in entries if format_of_name(_plain(name))), default="")
        if form := format_of_name(_plain(other)):
            # Of ROS 1, each file is a bag.
            bag = path if form == SQLITE else path / other
            why = f"it has {form} ({other}): {conversion(form, bag)}"
        raise FlockError(f"{path} is not a bag that can be read: {why}")
    if METADATA_FILE not in entries:
        missing = f"no {METADATA_FILE} (the recording was cut short)"
        return Listing(_in_order(found), missing=(missing,))
    information = _information(path)
    if information is None:
        return Listing(_in_order(found), missing=(_why_unreadable(path / METADATA_FILE),))
    return _listed(path, information, found)


def _why_unreadable(file: Path) -> str:
    with suppress(OSError):
        if file.stat().st_size > (limit := limits.LARGEST_METADATA_FILE):
            return f"{file.name} has more than {limit} bytes, the limit"
    return f"{file.name} can't be read"


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
    names = _names(information)
    if len(names) > limits.MOST_FILES:
        what = limits.beyond(len(names), limits.MOST_FILES, "files")
        missing.append(f"{METADATA_FILE} lists {what}")
    for name in names[: limits.MOST_FILES]:
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
        content = read_file(directory / METADATA_FILE, limits.LARGEST_METADATA_FILE)
        return _parsed(content.decode())
    except (OSError, ValueError):
        return None


def _parsed(text: str) -> Mapping[str, Any] | None:
    """Return the content of a metadata.yaml, with all values as texts; None if it is invalid."""
    if len(text) > limits.LARGEST_METADATA_FILE:
        return None
    try:
        document = yaml_text.parse_texts(_TOPICS.sub("", text), limits.MOST_METADATA_VALUES)
    except FlockError:
        return None
    information = document.get(_INFORMATION) if isinstance(document, dict) else None
    return information if isinstance(information, dict) else None


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
