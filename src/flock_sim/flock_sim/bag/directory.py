# SPDX-License-Identifier: Apache-2.0
"""The files in a bag's directory."""

from __future__ import annotations

import re
from pathlib import Path

METADATA_FILE = "metadata.yaml"
"""The description of a complete bag, written last."""

PART_FILE = f"{METADATA_FILE}.part"
"""The description while it is written."""

RESERVE_FILE = ".reserve"
"""Reserved disk space."""

PICTURE_FILE = "formation.png"
"""The picture of member 1 that may be in the directory of a bag."""

_OF_MEMBER = re.compile(r"formation_member_[1-9]\d*\.png")
"""The pictures of other members."""

REPORT_FILE = "report.html"
"""The report that may be in the directory of a bag."""

NEW_FILE = ".new.part"
"""A bag that has not begun yet, in the directory of the bag that it will replace."""

COPY_FILE = ".copy.part"
"""The sound part of a damaged file, while it is copied."""

LEFTOVERS = frozenset((PART_FILE, RESERVE_FILE, NEW_FILE, COPY_FILE))
"""Files that may remain of a bag that could not begin. Without a recording, they are worthless."""

DAMAGED = ".damaged"
"""Suffix of the name of a damaged file that was put aside; a number may follow it."""


def is_recording(name: str) -> bool:
    """Whether a file of this name may be the recording in a bag's directory.

    Hidden files are not: other systems keep them beside a file, such as ._x_0.mcap of a Mac.
    """
    return name.endswith(".mcap") and not name.startswith(".")


def bag_files(directory: Path) -> list[Path]:
    """List the content of a bag's directory in the order of removal; the recording is the last.

    metadata.yaml is the first: without it, the rest does not count as a complete bag.
    """
    order = (METADATA_FILE, PART_FILE)
    entries = list(directory.iterdir())
    return sorted(
        entries,
        key=lambda entry: (
            order.index(entry.name) if entry.name in order else len(order),
            entry.suffix == ".mcap",
            entry.name,
        ),
    )


def picture_file(member: int) -> str:
    """Return the name of the picture of `member` (from 1)."""
    return PICTURE_FILE if member == 1 else f"formation_member_{member}.png"


def is_written(name: str) -> bool:
    """Whether a recorder may be writing to a file of this name."""
    return name == NEW_FILE or is_recording(name)


def belongs_to_bag(name: str) -> bool:
    """Whether a file of this name may belong to a bag, its pictures and report included."""
    return (
        name
        in (METADATA_FILE, PART_FILE, RESERVE_FILE, COPY_FILE, NEW_FILE, PICTURE_FILE, REPORT_FILE)
        or _OF_MEMBER.fullmatch(name) is not None
        or Path(name).suffix == ".mcap"
        or name.rstrip("-0123456789").endswith(f".mcap{DAMAGED}")
    )
