# SPDX-License-Identifier: Apache-2.0
"""The directory of a sweep: its lock, its files, and the progress of its flights.

sweep.yaml         the sweep, and its division into flights: written first
flight_01.yaml     the configuration of a flight, as `fly --config` takes it
flight_01/         its bag
sweep.npz          instead of bags: the results so far of a sweep that the reference flies
sweep.nc sweep.png the result, written after all flights
.replaced/         the sweep that this one replaces, until a flight of this one has begun
"""

from __future__ import annotations

import fcntl
import os
import re
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from flock_sim.commands.resume import is_whole
from flock_sim.configuration import parameter_file
from flock_sim.console.arguments import note
from flock_sim.errors import FlockError
from flock_sim.outside.text import read_bytes
from flock_sim.recording.output_directory import own_output, remove_bag
from flock_sim.recording.run import Run
from flock_tools.experiments.sweep.specification import Flight

PLAN_FILE, DATA_FILE, PICTURE_FILE = "sweep.yaml", "sweep.nc", "sweep.png"
RESULTS_FILE = "sweep.npz"
PART = ".part"
REPLACED = ".replaced"

LOCK_PATIENCE = 20.0
"""Longest wait for a flight that a killed sweep left behind to end, in s."""

_OURS = re.compile(r"sweep\.(yaml|npz|nc|png)(\.part)?|flight_\d+(\.yaml)?")


class SweepDirectory:
    """The directory of a sweep, which no other process can use while it is `held`."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.data, self.picture = path / DATA_FILE, path / PICTURE_FILE
        self.results = path / RESULTS_FILE
        self.lock = -1
        """File descriptor that holds the lock; a child that inherits it holds the lock, too."""

    @contextmanager
    def held(self, plan: str, force: bool) -> Iterator[None]:
        """Lock the directory for the sweep of this `plan`, in the block.

        Raises FlockError if another process uses it, or if it holds anything else. With `force`,
        another sweep in it is replaced.
        """
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            self.lock = os.open(self.path, os.O_RDONLY | os.O_DIRECTORY)
        except OSError as error:
            raise FlockError(
                f"output {self.path} can't be written ({error.strerror}): name another --output"
            ) from error
        try:
            self._lock()
            self._settle()  # cleans up after a kill
            self._claim(plan, force)
            try:
                yield
            finally:
                self._settle()
        finally:
            os.close(self.lock)

    def bag(self, flight: Flight) -> Path:
        """Return the bag directory of a flight."""
        return self.path / f"flight_{flight.number:02d}"

    def configuration(self, flight: Flight) -> Path:
        """Write the configuration of a flight, and return its path."""
        file = self.path / f"flight_{flight.number:02d}.yaml"
        self.write(file, parameter_file.text(flight.configuration.parameters()).encode())
        return file

    def begun(self, flight: Flight) -> bool:
        """Return whether a flight on disk can be resumed."""
        return self._missing(flight) != ""

    def complete(self, flight: Flight) -> bool:
        """Return whether a flight has been flown to its end."""
        return self._missing(flight) is None

    def write(self, file: Path, content: bytes) -> None:
        """Write a file atomically. Raises FlockError if that fails."""
        part = file.with_name(file.name + PART)
        try:
            part.write_bytes(content)
            os.replace(part, file)
        except OSError as error:
            raise FlockError(f"output {file} can't be written ({error.strerror})") from error

    def _missing(self, flight: Flight) -> str | None:
        """Read the whole bag of a flight and return what it lacks; None if it is complete.

        Returns "" if the bag does not exist or has only a part of its beginning.
        """
        try:
            with Run(self.bag(flight)) as run:
                if not run.bag.topics:
                    return ""
                flown, missing = run.configuration, run.missing
                if not missing and not is_whole(run):
                    missing = f"{run.path} is damaged"
        except FlockError:
            return ""
        if flown != flight.configuration:
            raise FlockError(
                f"{self.bag(flight)}: is not the bag of flight {flight.number} of this sweep: name "
                "another --output, or replace the sweep with --force"
            )
        return missing

    def _lock(self) -> None:
        deadline = time.monotonic() + LOCK_PATIENCE
        waited = False
        while True:
            try:
                return fcntl.flock(self.lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                if time.monotonic() > deadline:
                    raise FlockError(
                        f"output {self.path}: another sweep is writing to it: wait for its end, "
                        "or name another --output"
                    ) from None
            if not waited:
                note(f"another process uses {self.path}: waiting for it to end")
            waited = True
            time.sleep(0.1)  # polls, because nothing announces the release of a lock

    def _claim(self, plan: str, force: bool) -> None:
        file = self.path / PLAN_FILE
        names = {entry.name for entry in self.path.iterdir()} - {PLAN_FILE + PART}
        if force and names:
            self._replace(names)
        elif PLAN_FILE in names:
            if read_bytes(file, "plan of a sweep") == plan.encode():
                return
            raise FlockError(
                f"output {self.path} holds another sweep, or one with other --members-at-once or "
                f"--reference ({PLAN_FILE} differs): add --force to replace it, or name another "
                "--output"
            )
        elif names:
            raise FlockError(f"output {self.path} exists and holds no sweep: name another --output")
        self.write(file, plan.encode())

    def _replace(self, names: set[str]) -> None:
        """Move a sweep aside, the plan last. After a kill in between, `_settle` moves it back."""
        if PLAN_FILE not in names or not all(map(_OURS.fullmatch, names)):
            raise FlockError(
                f"output {self.path} is not a sweep (it holds other things), and --force replaces "
                "only a sweep: name another --output"
            )
        with ExitStack() as flights:
            for name in sorted(names):
                if (self.path / name).is_dir():  # raises if it is in use or no bag
                    flights.enter_context(own_output(self.path / name, force=True))
            (self.path / REPLACED).mkdir()
            for name in sorted(names, key=lambda name: name == PLAN_FILE):
                (self.path / name).rename(self.path / REPLACED / name)

    def _settle(self) -> None:
        """Complete a replacement if a new flight has begun. Otherwise restore the old sweep."""
        replaced = self.path / REPLACED
        if not replaced.is_dir():
            return
        # The plan is moved aside last: before that, flights still in place are old ones.
        put_aside = (replaced / PLAN_FILE).exists()
        begun = self.results.exists() or any(map(_has_begun, self.path.glob("flight_*/")))
        if put_aside and begun:
            _empty(replaced)
        else:
            if put_aside:
                _empty(self.path)
            for entry in sorted(replaced.iterdir(), key=lambda entry: entry.name != PLAN_FILE):
                entry.rename(self.path / entry.name)
        replaced.rmdir()


def _has_begun(bag: Path) -> bool:
    """Return whether a bag has any message on disk."""
    try:
        with Run(bag) as run:
            return run.bag.last_time is not None
    except FlockError:
        return False


def _empty(directory: Path) -> None:
    """Remove the files of a sweep, the plan last."""
    ours = [entry for entry in directory.iterdir() if _OURS.fullmatch(entry.name)]
    for entry in sorted(ours, key=lambda entry: entry.name == PLAN_FILE):
        if entry.is_dir():
            remove_bag(entry)
        else:
            entry.unlink()
