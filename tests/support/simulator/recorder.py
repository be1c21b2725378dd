# SPDX-License-Identifier: Apache-2.0
"""The disk of a simulated flight, and the recording that one incarnation of the recorder writes."""

from __future__ import annotations

from collections.abc import Callable

from flock_sim.messages.types import Grant, Push
from flock_sim.recording.row_assembler import Row

RUN = 7
"""The run id of simulated flights."""


class Disk:
    """The rows, pushes and the last grant of a flight, which survive the recorder."""

    def __init__(self, check: Callable[[Row], None]) -> None:
        """`check` is called with each row before it is put on disk."""
        self.rows: list[Row] = []
        self.live: dict[int, Push] = {}
        """The pushes requested in flight, by number."""
        self.last_grant: Grant | None = None
        self.check = check

    @property
    def saved(self) -> int:
        """The step of the last row; -1 if there is none."""
        return self.rows[-1].step if self.rows else -1


class SimulatedRecording:
    """What a RecorderProtocol needs of a `Recording`: without `flush`, its data die with it."""

    closed = False

    def __init__(self, disk: Disk) -> None:
        self._disk = disk
        self.last_grant = disk.last_grant
        self.live = dict(disk.live)
        self._rows: list[Row] = []
        self._grant = disk.last_grant

    @property
    def saved(self) -> int:
        return self._disk.saved

    @property
    def checkpoint(self) -> list[bytes]:
        return self._disk.rows[-1].states if self._disk.rows else []

    @property
    def memories(self) -> list[bytes]:
        return self._disk.rows[-1].memories if self._disk.rows else []

    def write_row(self, row: Row) -> None:
        self._rows.append(row)

    def write_grant(self, data: bytes) -> None:
        self._grant = Grant.decode(data)

    def write_perturbation(self, push: Push) -> None:
        self.live[push.number] = push

    def flush(self) -> None:
        for row in self._rows:
            self._disk.check(row)
            self._disk.rows.append(row)
        self._rows = []
        self._disk.live = dict(self.live)
        self._disk.last_grant = self._grant
