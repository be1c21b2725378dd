# SPDX-License-Identifier: Apache-2.0
"""Flies the flights of a sweep, one after the other, as `./flock fly` does."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Sequence
from datetime import timedelta

from flock_sim.console.arguments import note
from flock_sim.console.signals import end_with_parent
from flock_sim.errors import RunFailed
from flock_tools.experiments.sweep.directory import SweepDirectory
from flock_tools.experiments.sweep.specification import Flight

GRACE = 15.0
"""Longest wait for a flight to end before SIGTERM, and then before SIGKILL, in s."""


def fly_all(flights: Sequence[Flight], directory: SweepDirectory, how: Sequence[str]) -> int:
    """Fly the remaining flights with options `how` of `fly`, and return their number.

    Raises RunFailed if a flight fails. The next call resumes that flight.
    """
    rest = [flight for flight in flights if not directory.complete(flight)]
    begun, steps = time.monotonic(), [flight.configuration.steps for flight in rest]
    for k, flight in enumerate(rest):
        members = len(flight.members)
        left = ""
        if k and sys.stderr.isatty():
            seconds = (time.monotonic() - begun) * sum(steps[k:]) / sum(steps[:k])
            left = f", about {timedelta(seconds=round(seconds))} left"
        note(
            f"flight {flight.number} of {len(flights)}: {members} member{'s' * (members > 1)} of "
            f"{flight.configuration.birds} birds, {flight.configuration.steps} steps{left}"
        )
        bag = str(directory.bag(flight))
        if directory.begun(flight):
            what = ["--resume", bag]
        else:
            file = directory.configuration(flight)
            what = ["--config", str(file), "--output", bag, "--force"]
        status = _fly([*what, *how], directory.lock)
        if status:
            raise RunFailed(
                f"flight {flight.number} of {len(flights)} ended with status {status}: the same "
                "command resumes it"
            )
    return len(rest)


def _fly(arguments: Sequence[str], lock: int) -> int:
    """Run `fly` and return its exit status. It ends with this process, and shares the lock."""
    command = [sys.executable, "-P", "-m", "flock_sim.commands.fly", *arguments]
    with subprocess.Popen(
        command,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        pass_fds=[lock],
        preexec_fn=end_with_parent,
    ) as process:
        try:
            return process.wait()
        except BaseException:
            _end(process)
            raise


def _end(process: subprocess.Popen[bytes]) -> None:
    """Make a flight end: it receives Ctrl-C, too; then SIGTERM and SIGKILL follow."""
    for harder in (process.terminate, process.kill):
        try:
            process.wait(GRACE)
            return
        except subprocess.TimeoutExpired:
            harder()
