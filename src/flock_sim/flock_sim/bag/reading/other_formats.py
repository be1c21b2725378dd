# SPDX-License-Identifier: Apache-2.0
"""Bags that are not MCAP: what they are, and how MCAP is made of them."""

from __future__ import annotations

import os
from pathlib import Path

SQLITE, ROS1 = "an SQLite bag of rosbag2", "a bag of ROS 1"

_SUFFIXES = {".db3": SQLITE, ".bag": ROS1}
_MAGICS = {b"SQLite f": SQLITE, b"#ROSBAG ": ROS1}
"""The first 8 bytes of a file, which is the length of MCAP's magic."""


def format_of_name(name: str) -> str | None:
    """Return what a file of this name is, if it is a bag in another format."""
    return _SUFFIXES.get(os.path.splitext(name)[1])


def format_of_content(magic: bytes) -> str | None:
    """Return what a file that begins with these 8 bytes is, if it is a bag in another format."""
    return _MAGICS.get(magic)


def conversion(what: str, path: Path) -> str:
    """Return how the bag at `path`, which is `what`, is converted; `path` may be one of its files.

    rosbag2 and rosbags read the metadata.yaml in the directory of an SQLite bag.
    """
    source = path.parent if what == SQLITE and not path.is_dir() else path
    or_else = ", or use ros2 bag convert" if what == SQLITE else ""
    return (
        f"convert it: pip install rosbags, then rosbags-convert --src {source} --dst NEW"
        f" --dst-storage mcap{or_else}"
    )
