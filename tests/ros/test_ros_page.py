# SPDX-License-Identifier: Apache-2.0
"""The code of docs/ros.md, and the bird in plain rclpy that it describes."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import numpy as np
import pytest
from ament_index_python.packages import get_package_share_directory

from flock_interfaces.msg import BirdState
from flock_sim.ros.discovery import PROFILES
from flock_tools.runs.dataset import load
from support.bags import last_step
from support.terminal import Job, Terminal
from support.visitor import Visitor, visiting

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "ros.md"
BIRD = ROOT / "examples" / "plain_bird.py"


def start_plain(terminal: Terminal, *words: object) -> Job:
    """Start a program without code of Flock. Its transports use no shared memory."""
    settings = Path(get_package_share_directory("flock_sim")) / "machine.xml"
    environment = {
        **terminal.environment,
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "SYSTEM_DEFAULT",
        PROFILES[0]: str(settings),
    }
    command = [sys.executable, "-P", *map(str, words)]
    return terminal.start_command("plain", command, env=environment)


def test_the_listener_of_the_page_hears_all_rows(terminal: Terminal) -> None:
    (code,) = re.findall(r"^```python\n(.*?)^```", PAGE.read_text(), re.DOTALL | re.MULTILINE)
    script = terminal.directory / "spacing.py"
    script.write_text(code)
    listener = start_plain(terminal, script).until_connected()
    # In real time: a listener that is discovered late still gets the first states.
    flown = ("--birds", 3, "--t-max", 100, "--mode", "free")
    terminal.well("fly", *flown, "--output", "bag")
    done = listener.wait(within=60.0)
    assert (done.status, done.stderr) == (0, "")
    position = load(terminal.directory / "bag").position.values[..., 0]
    expected = [
        f"step {10 * row}: " + " ".join(f"{gap:.4f}" for gap in np.diff(position[row]))
        for row in range(11)
    ]
    assert done.stdout.splitlines() == expected


def test_a_bird_in_plain_rclpy_flies_between_birds_of_flock(terminal: Terminal) -> None:
    """Also in a namespace. Its state has no means, so the run has none, but a digest."""
    given = ["--ros-args", "-r", "__ns:=/left", "-p", "birds:=3", "-p", "t_max:=200.0"]
    jobs = [
        terminal.start("clock", *given),
        terminal.start("recorder", *given, "-p", "output:=bag"),
        *(terminal.start("bird", *given, "-p", f"index:={bird}") for bird in (1, 3)),
        start_plain(terminal, BIRD, 2, *given[:3]),
    ]
    for job in jobs:
        done = job.wait()
        assert done.status == 0, done.stderr
    terminal.well("reference", "--birds", 3, "--t-max", 200, "--output", "reference")
    done = terminal.run("compare", "bag", "reference", "--tolerance", 1e-12, "--json")
    assert done.status == 0, done.stdout
    assert all(done.json["digests"])
    metrics = terminal.well("metrics", "bag")
    assert "not in this bag, whose states have no means" in metrics.stdout
    run = load(terminal.directory / "bag")
    assert run.speed.notnull().all()
    assert run.mean_speed.sel(bird=1).notnull().all()
    assert run.mean_speed.sel(bird=2).isnull().all()


@pytest.mark.slow
def test_a_plain_bird_starts_again_after_its_death(
    terminal: Terminal, monkeypatch: pytest.MonkeyPatch
) -> None:
    with visiting(terminal, monkeypatch) as visitor:
        _kill_and_start_again(terminal, visitor)
    end = last_step(terminal.directory / "bag")
    options = ("--birds", 2, "--t-max", end, "--record-every", 100)
    terminal.well("reference", *options, "--output", "reference")
    flown, expected = (load(terminal.directory / name) for name in ("bag", "reference"))
    assert flown.sizes["time"] == expected.sizes["time"]
    assert float(abs(flown.position - expected.position).max()) < 1e-9


def _kill_and_start_again(terminal: Terminal, visitor: Visitor) -> None:
    given = ["--ros-args", "-p", "birds:=2", "-p", "t_max:=1e5", "-p", "record_every:=100"]
    clock = terminal.start("clock", *given)
    recorder = terminal.start("recorder", *given, "-p", "output:=bag")
    bird = terminal.start("bird", *given, "-p", "index:=1")
    first = start_plain(terminal, BIRD, 2)
    clock.until_said("the flock flies, at step 0")
    first.process.kill()
    first.wait()
    second = start_plain(terminal, BIRD, 2)
    clock.until_said("the flock is rewound")
    clock.until(lambda: clock.stderr.count("the flock flies") == 2)
    states = visitor.hear(BirdState, "/flock/bird_02/state", depth=1)
    visitor.until(lambda: states and states[-1].step >= 300)
    visitor.stop(clock, recorder, bird, second)
