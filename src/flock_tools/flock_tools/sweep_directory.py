# SPDX-License-Identifier: Apache-2.0
"""The directory of a sweep: whose it is, and what of it is flown.

sweep.yaml         what is swept, and how it is shared out among flights: written first
flight_01.yaml     the configuration of a flight, as `fly --config` takes it
flight_01/         its bag
sweep.nc sweep.png the result, written when all is flown
"""

from __future__ import annotations

import fcntl
import os
import re
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from flock_sim import configuration_file
from flock_sim.bag.output import claim_output
from flock_sim.command_line import note
from flock_sim.errors import FlockError
from flock_sim.run import Run
from flock_tools.sweep_file import Flight

PLAN_FILE, DATA_FILE, PICTURE_FILE = "sweep.yaml", "sweep.nc", "sweep.png"
PART = ".part"

LOCK_PATIENCE = 20.0
"""How long, in s, a flight that was left behind by a kill may take to end."""

_OURS = re.compile(r"sweep\.(yaml|nc|png)(\.part)?|flight_\d+(\.yaml)?")


class SweepDirectory:
    """The directory of a sweep, which is nobody else's while `held`."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.data, self.picture = path / DATA_FILE, path / PICTURE_FILE
        self.lock = -1
        """The descriptor that holds the lock: who inherits it holds it too."""

    @contextmanager
    def held(self, plan: str, force: bool) -> Iterator[None]:
        """Have the directory for the sweep of this `plan`, in the block.

        Raises FlockError where it holds something else, unless `force` is set and that is a sweep,
        or where another process is at it.
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
            self._claim(plan, force)
            yield
        finally:
            os.close(self.lock)

    def bag(self, flight: Flight) -> Path:
        """Return where a flight is recorded."""
        return self.path / f"flight_{flight.number:02d}"

    def configuration(self, flight: Flight) -> Path:
        """Write the configuration of a flight, and return where."""
        file = self.path / f"flight_{flight.number:02d}.yaml"
        self.write(file, configuration_file.text(flight.configuration.parameters()).encode())
        return file

    def begun(self, flight: Flight) -> bool:
        """Return whether there is something of a flight on disk that can be gone on with."""
        return self._missing(flight) != ""

    def complete(self, flight: Flight) -> bool:
        """Return whether a flight has been flown to its end."""
        return self._missing(flight) is None

    def write(self, file: Path, content: bytes) -> None:
        """Write a file as a whole or not at all. Raises FlockError where that fails."""
        part = file.with_name(file.name + PART)
        try:
            part.write_bytes(content)
            os.replace(part, file)
        except OSError as error:
            raise FlockError(f"output {file} can't be written ({error.strerror})") from error

    def _missing(self, flight: Flight) -> str | None:
        """Return what the bag of a flight lacks: None for nothing, "" where there is no bag."""
        try:
            with Run(self.bag(flight)) as run:
                flown, missing = run.configuration, run.missing
        except FlockError:
            return ""
        if flown != flight.configuration:
            raise FlockError(
                f"{self.bag(flight)}: is not what flight {flight.number} of this sweep flies: name "
                "another --output, or begin anew with --force"
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
                        f"output {self.path}: another sweep is flying into it: wait for its end, "
                        "or name another --output"
                    ) from None
            if not waited:
                note(f"another process is at {self.path}: waiting for its end")
            waited = True
            time.sleep(0.1)  # a poll of a lock, whose end nothing announces

    def _claim(self, plan: str, force: bool) -> None:
        file = self.path / PLAN_FILE
        names = {entry.name for entry in self.path.iterdir()} - {PLAN_FILE + PART}
        if force and names:
            self._empty(names)
        elif PLAN_FILE in names:
            if file.read_text(encoding="utf-8", errors="replace") == plan:
                return
            raise FlockError(
                f"output {self.path} holds another sweep, or one with other --members-at-once "
                f"({PLAN_FILE} differs): add --force to replace it, or name another --output"
            )
        elif names:
            raise FlockError(f"output {self.path} exists and holds no sweep: name another --output")
        self.write(file, plan.encode())

    def _empty(self, names: set[str]) -> None:
        """Remove a sweep, the plan last: what is left of it by a kill is a sweep still."""
        if PLAN_FILE not in names or not all(map(_OURS.fullmatch, names)):
            raise FlockError(
                f"output {self.path} is not a sweep (it holds other things), and --force replaces "
                "only a sweep: name another --output"
            )
        for name in sorted(names, key=lambda name: name == PLAN_FILE):
            entry = self.path / name
            if entry.is_dir():
                claim_output(entry, force=True)
                entry.rmdir()
            else:
                entry.unlink()
