# SPDX-License-Identifier: Apache-2.0
"""Flying the flights of a sweep, one after the other, as `./flock fly` does."""

from __future__ import annotations

import ctypes
import signal
import subprocess
import sys
from collections.abc import Sequence

from flock_sim.command_line import note
from flock_sim.errors import RunFailed
from flock_tools.sweep_directory import SweepDirectory
from flock_tools.sweep_file import Flight

PR_SET_PDEATHSIG = 1

GRACE = 15.0
"""How long, in s, a flight may take to end before it is told so more rudely."""

_libc = ctypes.CDLL(None)


def fly_all(flights: Sequence[Flight], directory: SweepDirectory, how: Sequence[str]) -> int:
    """Fly what is not flown yet, and return how many flights that were; `how`: options of `fly`.

    Raises RunFailed where a flight fails; what it has recorded is gone on with by the next try.
    """
    flown = 0
    for flight in flights:
        if directory.complete(flight):
            continue
        flown += 1
        members = len(flight.members)
        note(
            f"flight {flight.number} of {len(flights)}: {members} member{'s' * (members > 1)} of "
            f"{flight.configuration.birds} birds, {flight.configuration.steps} steps"
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
                "command goes on with it"
            )
    return flown


def _fly(arguments: Sequence[str], lock: int) -> int:
    """Run `fly` and return its exit status. It ends when we do, and has the directory till then."""
    command = [sys.executable, "-P", "-m", "flock_sim.fly", *arguments]
    with subprocess.Popen(
        command,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        pass_fds=[lock],
        preexec_fn=_follow_parent,
    ) as process:
        try:
            return process.wait()
        except BaseException:
            _end(process)
            raise


def _end(process: subprocess.Popen[bytes]) -> None:
    """See that a flight ends, in order if it can: Ctrl-C has been heard by it, too."""
    for harder in (process.terminate, process.kill):
        try:
            process.wait(GRACE)
            return
        except subprocess.TimeoutExpired:
            harder()


def _follow_parent() -> None:
    _libc.prctl(PR_SET_PDEATHSIG, signal.SIGTERM)
