# SPDX-License-Identifier: Apache-2.0
"""What tests look for in bags."""

from __future__ import annotations

from itertools import islice
from pathlib import Path

from flock_sim.errors import FlockError
from flock_sim.run import Run
from terminal import Terminal


def last_step(bag: Path) -> int:
    """Return the last step that is on disk; -1 for none."""
    try:
        with Run(bag) as run:
            return run.at().step
    except FlockError:
        return -1


def assert_equal(terminal: Terminal, bag: str, reference: str, messages: int) -> None:
    """Hold that two bags are complete and say the same, each state once, to the bit."""
    done = terminal.run("compare", bag, reference, "--json")
    assert done.status == 0, done.stdout + done.stderr
    assert done.json["messages"] == messages
    for name in (bag, reference):
        with Run(terminal.directory / name) as run:
            assert run.missing is None


def assert_begins_as(bag: Path, whole: Path) -> int:
    """Hold that the states of `bag` are the first ones of `whole`; return how many they are."""
    with Run(bag) as part, Run(whole) as run:
        flown = [(bird, state.encode()) for bird, state in part.states()]
        first = islice(run.states(), len(flown))
        assert flown == [(bird, state.encode()) for bird, state in first]
    return len(flown)
