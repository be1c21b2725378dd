# SPDX-License-Identifier: Apache-2.0
"""Time breakdown of the processes of birds, passed as files to the process that starts them."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import asdict, astuple, dataclass
from pathlib import Path

from flock_sim.errors import FlockError


@dataclass(frozen=True)
class TimeBreakdown:
    """Wall time in s, from the first stage of a flight to its last; for several processes, the sum.

    It is wall time, so the wait for a busy processor counts to the work that was about to run.
    """

    kernel: float
    """Time in the compiled functions that compute a stage."""
    messages: float
    """Time to take, decode, encode and send messages: all other work of a process."""
    waiting: float
    """Time in polls that find no message, and in yields and sleeps."""

    @classmethod
    def sum(cls, times: Iterable[TimeBreakdown]) -> TimeBreakdown:
        """Return the times of several processes, summed."""
        return cls(*map(sum, zip((0.0, 0.0, 0.0), *map(astuple, times))))

    @classmethod
    def read(cls, file: Path) -> TimeBreakdown:
        """Return the times that a process has written."""
        return cls(**json.loads(file.read_text(encoding="utf-8")))

    def write(self, file: Path) -> None:
        """Write the times for `read`. Raises FlockError if the file can't be written."""
        try:
            file.write_text(json.dumps(asdict(self)), encoding="utf-8")
        except OSError as error:
            raise FlockError(
                f"stopwatch {file}: can't be written ({error.strerror}): name another file"
            ) from error

    def shares(self) -> dict[str, float]:
        """Return the share of each time in the total; 0 if the total is 0."""
        total = self.kernel + self.messages + self.waiting
        return {name: value / total if total else 0.0 for name, value in asdict(self).items()}
