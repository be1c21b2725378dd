# SPDX-License-Identifier: Apache-2.0
"""The directory of a recording, which one process owns through a lock on it.

A process owns a directory before it records to it or replaces its content. The process that writes
the file (under `fly`, the recorder) also has a lock on the file. If the owner is killed, this lock
remains as long as the file is written to.
"""

from __future__ import annotations

import itertools
import os
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

from flock_sim.bag.directory import (
    LEFTOVERS,
    METADATA_FILE,
    NEW_FILE,
    bag_files,
    belongs_to_bag,
    is_recording,
    is_written,
)
from flock_sim.bag.lock import is_locked, lock
from flock_sim.errors import FlockError, RunFailed
from flock_sim.outside.printing import shown

LONGEST_NAME = 230
"""Longest name of a bag's directory, in bytes: the names of its files are longer, and systems allow
255 bytes."""

ORPHAN_TIMEOUT = 5.0
"""Longest wait, in s, for the end of a recorder whose owner was killed."""


@dataclass
class Output:
    """A directory that this process owns. Close it, or use it in a `with` statement."""

    path: Path
    replaces: bool
    """Whether the directory has a bag, which the new bag replaces once it has begun."""
    made: bool
    """Whether the directory is new."""
    _fd: int

    def check(self) -> None:
        """Raise RunFailed if the directory was moved, removed or replaced, or can't be read."""
        there = None
        try:
            ours = os.fstat(self._fd)
            with suppress(FileNotFoundError, NotADirectoryError):
                there = os.stat(self.path)
        except OSError as error:
            raise RunFailed(
                f"output {self.path} can't be read ({error.strerror}): what is there now is unknown"
            ) from error
        if there is None or (there.st_dev, there.st_ino) != (ours.st_dev, ours.st_ino):
            raise RunFailed(
                f"output {self.path} was moved or removed during the recording: what is there now "
                "is unknown"
            )

    def close(self) -> None:
        """Release the directory.

        A new bag that has not begun is removed, and so is a new directory that is empty.
        """
        with suppress(OSError):
            os.unlink(NEW_FILE, dir_fd=self._fd)
        if self.made:
            _unmake([self.path])
        os.close(self._fd)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


class OutputExists(FlockError):
    """The output exists, and must not be replaced."""


def own_output(path: str | Path, force: bool) -> Output:
    """Own the directory `path` for a new bag; a missing directory is made, with its parents.

    An existing path is refused, unless `force` is set and it is an empty directory or a bag: a
    directory that holds metadata.yaml or, if a run was cut short, one .mcap file, and only files of
    a bag. So is what remains of a bag that could not begin. The old bag stays until the new one has
    begun and replaces it.

    Raises FlockError if the path is refused, can't be written, or another process owns it; nothing
    has changed then.
    """
    output = Path(path)
    _check_name(output)
    try:
        if not output.exists():
            made = _make(output)
            try:
                return _own(output, made=True)
            except OSError:
                _unmake(made)
                raise
        if not force:
            raise OutputExists(
                f"output {output} exists: add --force to replace it, or name another --output"
            )
        _check_bag(output)
        return _own(output, replaces=any(output.iterdir()))
    except OSError as error:
        raise FlockError(
            f"output {output} can't be written ({error.strerror}): name another --output"
        ) from error


def own_new_output(path: str | Path) -> Output:
    """Own a new directory: `path` or, if it exists, `path`-2, -3, ...

    Raises FlockError as `own_output` does.
    """
    first = Path(path)
    for number in itertools.count(2):
        try:
            return own_output(first, force=False)
        except OutputExists:
            first = Path(f"{path}-{number}")
    raise AssertionError


def own_bag(path: str | Path) -> Output:
    """Own the directory of the bag `path`, to resume it; raises FlockError as `own_output`."""
    bag = Path(path)
    try:
        return _own(bag)
    except OSError as error:
        raise FlockError(f"{bag} can't be read ({error.strerror}): name a bag directory") from error


def remove_bag(path: Path) -> None:
    """Remove the directory of a bag. Raises FlockError as `own_output` does, with force."""
    with own_output(path, force=True):
        for entry in bag_files(path):
            entry.unlink()
        path.rmdir()


def _own(directory: Path, *, replaces: bool = False, made: bool = False) -> Output:
    """Lock `directory`. Raises OSError, or FlockError if another process records to it."""
    fd = os.open(directory, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        lock(fd)
        with suppress(OSError):  # left by a kill; missing write access is reported later
            if not is_locked(directory / NEW_FILE):
                os.unlink(NEW_FILE, dir_fd=fd)
        _wait_for_orphan(directory)
    except BlockingIOError as error:
        os.close(fd)
        raise FlockError(
            f"another process is recording to {directory}: wait for its end, or name another "
            "directory"
        ) from error
    except OSError:
        os.close(fd)
        raise
    return Output(directory, replaces, made, fd)


def _wait_for_orphan(directory: Path) -> None:
    """Wait while another process still writes to a file in the directory, which this one owns.

    Raises BlockingIOError if this takes longer than ORPHAN_TIMEOUT.
    """
    deadline = time.monotonic() + ORPHAN_TIMEOUT
    while any(is_locked(entry) for entry in directory.iterdir() if is_written(entry.name)):
        if time.monotonic() > deadline:
            raise BlockingIOError
        time.sleep(0.05)  # a poll: the release of a lock sends no event


def _check_name(directory: Path) -> None:
    """Raise FlockError if the names of a bag's files can't be made of that of its directory."""
    name = os.path.basename(os.path.realpath(directory))
    try:
        size = len(name.encode())
    except UnicodeEncodeError as error:  # metadata.yaml names the files, in UTF-8
        raise FlockError(
            f"output {directory}: its name is not UTF-8 text: name another --output"
        ) from error
    if size > LONGEST_NAME:
        raise FlockError(
            f"output {shown(str(directory))}: its name has {size} bytes; {LONGEST_NAME} are the "
            "limit: name another --output"
        )


def _make(directory: Path) -> list[Path]:
    """Make a directory with its parents; return those that were missing, from the innermost on.

    Raises OSError, and OutputExists if another process has made it meanwhile.
    """
    missing = [directory, *(parent for parent in directory.parents if not parent.exists())]
    try:
        directory.mkdir(parents=True)
    except FileExistsError as error:
        raise OutputExists(f"output {directory} exists: name another --output") from error
    except OSError:
        _unmake(missing[1:])
        raise
    return missing


def _unmake(made: Sequence[Path]) -> None:
    """Remove those of the directories that are empty."""
    for directory in made:
        with suppress(OSError):
            directory.rmdir()


def _check_bag(directory: Path) -> None:
    """Raise FlockError unless `directory` is a bag, or empty, and may be written to."""
    if not directory.is_dir():
        raise FlockError(
            f"output {directory} is not a directory, and --force replaces only a bag:"
            " name another --output"
        )
    entries = list(directory.iterdir())
    names = {entry.name for entry in entries} - {NEW_FILE}
    is_bag = METADATA_FILE in names or sum(map(is_recording, names)) == 1 or names <= LEFTOVERS
    plain = all(entry.is_symlink() or entry.is_file() for entry in entries)
    if names and not (is_bag and plain and all(map(belongs_to_bag, names))):
        raise FlockError(
            f"output {directory} is not a bag (it contains other files), and --force replaces only"
            " a bag: name another --output"
        )
    if not os.access(directory, os.W_OK | os.X_OK):
        raise FlockError(
            f"output {directory} can't be written (Permission denied): name another --output"
        )
