# SPDX-License-Identifier: Apache-2.0
"""The ROS environment is checked before a process is started or a bag is changed."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from flock_sim.commands.fly import tool as fly
from flock_sim.configuration.operation import parted
from flock_sim.errors import FlockError
from flock_sim.ros.discovery import ELSEWHERE, LOCALHOST_ONLY, PROFILES, TRANSPORTS
from flock_tools.commands.play import tool as play
from flock_tools.commands.sweep import tool as sweep
from flock_tools.commands.view import tool as view
from flock_tools.commands.watch import tool as watch
from support.tool_runs import Tool, error_of

RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"

WRONG = {
    "RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp",
    "ROS_DOMAIN_ID": "043",
    RANGE: "OFF",
    "ROS_STATIC_PEERS": "not a host",
}


@pytest.fixture(autouse=True)
def environment(monkeypatch: pytest.MonkeyPatch) -> None:
    """An environment that says nothing, and is as it was before once the test has ended."""
    ros = ("ROS_DOMAIN_ID", "RMW_IMPLEMENTATION", RANGE, LOCALHOST_ONLY, *ELSEWHERE)
    for name in (*ros, *PROFILES, TRANSPORTS):
        monkeypatch.setenv(name, "")


@pytest.fixture
def kept(tmp_path: Path) -> Path:
    """A file in a bag, or a sweep, that an option says to replace."""
    file = tmp_path / "bag" / "metadata.yaml"
    file.parent.mkdir()
    file.write_text("rosbag2_bagfile_information: {}\n")
    return file


def flying(kept: Path) -> tuple[Tool, list[str]]:
    return fly, ["--t-max", "10", "--output", str(kept.parent), "--force"]


def sweeping(kept: Path) -> tuple[Tool, list[str]]:
    file = kept.parent.with_name("delays.yaml")
    file.write_text("axes: {link.delay: [0]}\n")
    kept.rename(kept.with_name("sweep.nc"))
    kept.with_name("sweep.yaml").write_text("another\n")
    return sweep, [str(file), "--output", str(kept.parent), "--force"]


@pytest.mark.parametrize("name", WRONG)
@pytest.mark.parametrize("called", [flying, sweeping])
def test_no_bag_is_touched(
    kept: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    called: Callable[[Path], tuple[Tool, list[str]]],
    name: str,
) -> None:
    tool, arguments = called(kept)
    before = sorted(file.name for file in kept.parent.iterdir())
    monkeypatch.setenv(name, WRONG[name])
    assert f"{name} = {WRONG[name]}: " in error_of(tool, capsys, *arguments)
    assert sorted(file.name for file in kept.parent.iterdir()) == before


@pytest.mark.parametrize("name", WRONG)
@pytest.mark.parametrize(
    ("tool", "arguments"),
    [(watch, ["--once"]), (view, []), (play, ["missing"])],
    ids=["watch", "view", "play"],
)
def test_what_listens_or_plays_is_as_strict(
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    tool: Tool,
    arguments: list[str],
    name: str,
) -> None:
    monkeypatch.setenv(name, WRONG[name])
    assert f"{name} = {WRONG[name]}: " in error_of(tool, capsys, *arguments)


@pytest.mark.parametrize("tool", [fly, watch, view], ids=["fly", "watch", "view"])
def test_localhost_only_excludes_the_network(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tool: Tool, tmp_path: Path
) -> None:
    monkeypatch.setenv(LOCALHOST_ONLY, "1")
    more = {fly: ["--output", str(tmp_path / "bag")], watch: ["--once"], view: []}[tool]
    said = error_of(tool, capsys, "--network", *more)
    assert f"{LOCALHOST_ONLY} = 1 and --network exclude each other" in said
    assert not (tmp_path / "bag").exists()


NODES = """
import sys
from flock_sim.nodes import executables

sys.argv = ["node", "--ros-args", "-p", "birds:=2"]
print([getattr(executables, name)() for name in ("bird", "clock", "recorder")])
assert "rclpy" not in sys.modules
"""


def process(*words: str) -> subprocess.CompletedProcess[str]:
    """Run Python where a middleware is asked for that is not there."""
    return subprocess.run(
        [sys.executable, "-P", *words],
        env={**os.environ, "RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp"},
        capture_output=True,
        text=True,
        check=False,
    )


def test_nodes_check_the_middleware_before_they_load_it() -> None:
    # ROS would end the process with status 102, and words of its own, as soon as it is loaded.
    done = process("-c", NODES)
    assert done.stdout == "[2, 2, 2]\n", done.stderr
    assert done.stderr.count("error: RMW_IMPLEMENTATION = rmw_cyclonedds_cpp: ") == 3
    assert done.stderr.count("\n") == 3


def test_the_reference_does_not_look_at_the_middleware(tmp_path: Path) -> None:
    flock = ["--birds", "2", "--t-max", "4", "--output", str(tmp_path / "bag")]
    done = process("-m", "flock_sim.commands.reference", *flock)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    ("key", "value"),
    [("window", 0), ("window", 2**62), ("timeout", 1e300), ("timeout", 10**400), ("run_id", -1)],
)
def test_parameters_of_any_size_are_refused_or_taken(key: str, value: float) -> None:
    with pytest.raises(FlockError) as refused:
        parted({key: value})
    assert key in str(refused.value)
    assert len(str(refused.value)) < 250


def test_a_run_may_have_any_number_that_ros_has() -> None:
    assert parted({"run_id": 2**63 - 1}) == ({}, {"run_id": 2**63 - 1})
