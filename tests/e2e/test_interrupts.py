# SPDX-License-Identifier: Apache-2.0
"""Ctrl-C, at any moment and repeatedly, ends a flight with one line. Its bag can be resumed.

FLOCK_INTERRUPTS=N interrupts N flights instead of a few.
"""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path
from random import Random

import pytest

from support.bags import assert_equal
from support.terminal import Job, Terminal

ROOT = Path(__file__).parents[2]
COUNT = int(os.environ.get("FLOCK_INTERRUPTS", "4"))
FLOCK = ("--birds", "3", "--t-max", "12000", "--record-every", "10")
STATES = 3 * 1201


def press(job: Job, random: Random) -> None:
    """Press Ctrl-C once or more, at moments between the first line of Python and the end."""
    for _ in range(random.choice([1, 2, 3, 6])):
        # No moment is right or wrong, so nothing is waited for.
        time.sleep(random.choice([random.uniform(0.0, 0.5), random.uniform(0.0, 2.0)]))
        job.interrupt()


@pytest.mark.parametrize("seed", range(COUNT))
@pytest.mark.slow
def test_a_flight_ends_at_ctrl_c_and_goes_on_from_where_it_was(
    terminal: Terminal, seed: int
) -> None:
    random = Random(seed)
    how = ["--processes", str(random.randint(1, 3)), "--output", "bag"]
    job = terminal.start_command("fly", [str(ROOT / "flock"), "fly", *FLOCK, *how])
    press(job, random)
    done = job.wait()
    # -SIGINT: before the tool was there.
    assert done.status in (0, 130, -signal.SIGINT), done.stderr
    assert "Traceback" not in done.stderr
    assert "error" not in done.stderr
    assert terminal.processes() == []
    if (terminal.directory / "bag").exists():
        terminal.well("fly", "--resume", "bag")
        terminal.well("reference", *FLOCK, "--output", "reference")
        assert_equal(terminal, "bag", "reference", STATES)
