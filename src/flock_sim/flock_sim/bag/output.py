# SPDX-License-Identifier: Apache-2.0
"""Claiming the directory that a run is recorded to, before anything starts."""

import os
from contextlib import suppress
from pathlib import Path

from flock_sim.bag.reserve import RESERVE_FILE
from flock_sim.bag.rosbag2_metadata import METADATA_FILE, PART_FILE
from flock_sim.errors import FlockError

PICTURE_FILE = "formation.png"
"""The picture that may lie beside a bag."""

REPORT_FILE = "report.html"
"""The report that may."""


def claim_output(path: str | Path, force: bool) -> None:
    """Make `path` an empty directory, for `BagWriter` to fill; its parents are made too.

    What exists is refused, unless `force` is set and it is an empty directory or a bag: a
    directory that holds metadata.yaml or, where a run was cut short, one .mcap file, and nothing
    that a bag's does not hold. Then its files are removed.

    Raises FlockError when it is refused or can't be written; nothing has changed then.
    """
    output = Path(path)
    try:
        if output.exists():
            if not force:
                raise FlockError(
                    f"output {output} exists: add --force to replace it, or name another --output"
                )
            _empty(output)
        else:
            _make(output)
    except OSError as error:
        raise FlockError(
            f"output {output} can't be written ({error.strerror}): name another --output"
        ) from error


def _make(directory: Path) -> None:
    missing = [parent for parent in directory.parents if not parent.exists()]
    try:
        directory.mkdir(parents=True)
    except OSError:
        for parent in missing:  # from the innermost outwards
            with suppress(OSError):
                parent.rmdir()
        raise


def _of_a_bag(name: str) -> bool:
    """Whether a bag's directory, and what is drawn into it, may have a file of this name."""
    return (
        name in (METADATA_FILE, PART_FILE, RESERVE_FILE, PICTURE_FILE, REPORT_FILE)
        or Path(name).suffix == ".mcap"
    )


def _empty(directory: Path) -> None:
    if not directory.is_dir():
        raise FlockError(
            f"output {directory} is not a directory, and --force replaces only a bag:"
            " name another --output"
        )
    entries = list(directory.iterdir())
    names = {entry.name for entry in entries}
    is_bag = METADATA_FILE in names or sum(name.endswith(".mcap") for name in names) == 1
    plain = all(entry.is_symlink() or entry.is_file() for entry in entries)
    if entries and not (is_bag and plain and all(map(_of_a_bag, names))):
        raise FlockError(
            f"output {directory} is not a bag (it holds other things), and --force replaces only"
            " a bag: name another --output"
        )
    if not os.access(directory, os.W_OK | os.X_OK):
        raise FlockError(
            f"output {directory} can't be written (Permission denied): name another --output"
        )
    # metadata.yaml first: without it nobody takes what is left for a complete bag.
    for entry in sorted(entries, key=lambda entry: entry.name != METADATA_FILE):
        entry.unlink()
