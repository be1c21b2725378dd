# SPDX-License-Identifier: Apache-2.0
"""Where the time of the processes of birds went, from each process to who started them."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import asdict, astuple, dataclass
from pathlib import Path

from flock_sim.errors import FlockError


@dataclass(frozen=True)
class Times:
    """Wall time in s, from the first stage of a flight to its last; of several processes, summed.

    It is measured by the clock on the wall, so it counts what a process waits for a processor
    that others have, to whatever it was about to do.
    """

    kernel: float
    """In the compiled functions that compute a stage."""
    messages: float
    """In taking, understanding, making and sending messages: all else that a process does."""
    waiting: float
    """In looking for messages in vain, and giving the processor away."""

    @classmethod
    def sum(cls, times: Iterable[Times]) -> Times:
        """Return the times of several processes, summed."""
        return cls(*map(sum, zip((0.0, 0.0, 0.0), *map(astuple, times))))

    @classmethod
    def read(cls, file: Path) -> Times:
        """Return what a process has written."""
        return cls(**json.loads(file.read_text(encoding="utf-8")))

    def write(self, file: Path) -> None:
        """Write the times, to be read by `read`. Raises FlockError where that can't be."""
        try:
            file.write_text(json.dumps(asdict(self)), encoding="utf-8")
        except OSError as error:
            raise FlockError(
                f"stopwatch {file}: can't be written ({error.strerror}): name another file"
            ) from error

    def shares(self) -> dict[str, float]:
        """Return which part of all the time each of them is; of no time, none."""
        total = self.kernel + self.messages + self.waiting
        return {name: value / total if total else 0.0 for name, value in asdict(self).items()}
