# SPDX-License-Identifier: Apache-2.0
"""Flights with laws of one's own are killed, resumed, repeated, and read without the file."""

from __future__ import annotations

import os
import shutil
import signal
from pathlib import Path
from random import Random

import numpy as np
import pytest

from flock_sim.recording.run import Run
from flock_tools.runs.dataset import load
from support.bags import assert_equal, last_step
from support.terminal import Terminal
from support.varied_flights import cut

LAWS = Path(__file__).parents[1] / "support/laws.py"
BIRD = "flock_sim.nodes.bird_process"

STEPS = 12_000
FLOCK = ("--birds", 3, "--t-max", STEPS, "--record-every", 10)
SLOWLY = ("--processes", 2, "--window", 2)
"""The flight takes 10 s, so that no kill comes too late for it. It has the same values."""
FORCING = (
    *("--forcing", "gust:std=1e-5,time=30,seed=4/5"),
    *("--forcing", "laws.py:cruise:speed=1.02,shake=1e-4,seed=1/2"),
    *("--forcing", "3=laws.py:lean:gap=0.4"),
)


@pytest.fixture
def laws(terminal: Terminal) -> Path:
    return Path(shutil.copy(LAWS, terminal.directory / "laws.py"))


LINKS = ("--link", "hold:interval=3,delay=2,drop=0.2")


@pytest.mark.parametrize("links", [(), LINKS], ids=str)
@pytest.mark.slow
def test_a_flight_is_killed_and_resumed_with_the_law_that_it_was_begun_with(
    terminal: Terminal, laws: Path, links: tuple[object, ...]
) -> None:
    bag = terminal.directory / "bag"
    flight = terminal.start("fly", *FLOCK, *links, *FORCING, *SLOWLY, "--output", "bag")
    flight.until(lambda: last_step(bag) > 0)
    os.kill(flight.workers(BIRD)[0], signal.SIGKILL)
    flight.until_said("was killed by SIGKILL: started again")
    before = last_step(bag)
    flight.until(lambda: last_step(bag) > before)
    flight.interrupt()
    assert flight.wait().status == 130

    refused = terminal.run("fly", "--resume", "bag")
    assert refused.status == 2
    assert "it was flown with the law laws.py:cruise" in refused.error
    assert "--law laws.py" in refused.error
    terminal.well("reference", *FLOCK, *links, *FORCING, "--output", "reference")

    moved = terminal.directory / "moved.py"
    laws.rename(moved)
    laws.write_text("def cruise(bird):\n    raise SystemExit('a bag has caused this to run')\n")
    refused = terminal.run("fly", "--resume", "bag", "--law", "laws.py")
    assert refused.status == 2
    assert "of digest sha256:" in refused.error
    terminal.well("fly", "--resume", "bag", "--law", "moved.py", "--processes", 3)
    assert_equal(terminal, "bag", "reference", 3 * (STEPS // 10 + 1))

    terminal.well("reference", "--repeat", "bag", "--law", "moved.py", "--output", "again")
    assert_equal(terminal, "again", "reference", 3 * (STEPS // 10 + 1))
    with Run(bag) as run:
        assert [part.name for part in run.own_parts] == ["laws.py:cruise", "laws.py:lean"]
        assert len({part.digest for part in run.own_parts}) == 1


@pytest.mark.slow
def test_every_tool_that_reads_the_bag_does_without_the_file(
    terminal: Terminal, laws: Path
) -> None:
    terminal.well("fly", *FLOCK, *FORCING, "--output", "bag")
    laws.unlink()
    torn = Path(shutil.copytree(terminal.directory / "bag", terminal.directory / "torn"))
    cut(Random(1), torn)
    for words in (
        ("metrics", "bag"),
        ("compare", "bag", "bag"),
        ("report", "bag", "--output", "page.html"),
        ("picture", "bag", "--output", "picture.png"),
        ("view", "bag", "--picture", "view.png"),
        ("repair", "torn", "--output", "repaired"),
        ("play", "bag", "--rate", 1e6),
    ):
        done = terminal.run(*words)
        assert done.status == 0, (words, done.stderr)
    with Run(torn.with_name("repaired")) as run, Run(torn) as before:
        assert run.own_parts == before.own_parts
        last = before.at()  # `repair` also finds the messages before a cut in the last chunk
        assert run.at().step >= last.step
        assert np.array_equal(run.at(last.time).forcing_state, last.forcing_state)
    flown = load(terminal.directory / "bag")
    assert flown.forcing_state.dims == ("time", "bird", "state_number", "member")
    assert flown.forcing_state.shape == (STEPS // 10 + 1, 3, 3, 2)
    assert flown.attrs["own_parts"] == "law laws.py:cruise, law laws.py:lean"
