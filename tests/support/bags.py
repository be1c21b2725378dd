# SPDX-License-Identifier: Apache-2.0
"""Checks of bags."""

from __future__ import annotations

from itertools import islice
from pathlib import Path

from flock_sim.errors import FlockError
from flock_sim.recording.run import Run
from support.terminal import Terminal


def last_step(bag: Path) -> int:
    """Return the last step on disk; -1 for none."""
    try:
        with Run(bag) as run:
            return run.at().step
    except FlockError:
        return -1


def assert_equal(terminal: Terminal, bag: str, reference: str, messages: int) -> None:
    """Assert that two bags are complete and equal bit for bit, with each state once.

    Both have the digest of these states.
    """
    done = terminal.run("compare", bag, reference, "--json")
    assert done.status == 0, done.stdout + done.stderr
    assert done.json["messages"] == messages
    first, second = done.json["digests"]
    assert first == second
    assert first.startswith("sha256:")
    for name in (bag, reference):
        with Run(terminal.directory / name) as run:
            assert run.missing is None


def assert_begins_as(bag: Path, whole: Path) -> int:
    """Assert that the states of `bag` are the first ones of `whole`. Return their number."""
    with Run(bag) as part, Run(whole) as run:
        flown = [(bird, state.encode()) for bird, state in part.states()]
        first = islice(run.states(), len(flown))
        assert flown == [(bird, state.encode()) for bird, state in first]
    return len(flown)


def assert_stopped_as_the_reference(
    terminal: Terminal, birds: int, every: int, *flock: object, bag: str = "bag"
) -> None:
    """Assert that `bag`, a flight without an end, equals the reference up to its last step.

    The flight was stopped in order: the bag has each state once, bit for bit, and is complete.
    `flock` are the options of the flock.
    """
    flown, reference = terminal.directory / bag, terminal.directory / f"reference-of-{bag}"
    end = last_step(flown)
    terminal.well("reference", *flock, "--t-max", end, "--output", reference)
    with Run(flown) as run:
        assert run.bag.missing is None
        assert run.missing is not None
        assert "the flight was ended" in run.missing
    assert assert_begins_as(flown, reference) == birds * (end // every + 1)
    with Run(flown) as part, Run(reference) as run:
        assert part.state_digest == run.state_digest is not None
