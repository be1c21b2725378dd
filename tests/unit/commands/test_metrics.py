# SPDX-License-Identifier: Apache-2.0
"""`metrics` prints the specified output, needs no ROS, and refuses unreadable bags in one line."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.console.arguments import run_tool
from flock_sim.recording.run import Run
from flock_tools.commands.metrics import tool
from support.flights import record

KEYS = {
    *("birds", "members", "coupling", "dt", "steps", "t_final", "leader", "mean_speed"),
    *("speed_std", "stable", "spacing", "position", "lateral", "drag_reduction"),
    *("mean_drag_reduction", "hierarchical", "profile_error", "state_digest"),
    *("verdict", "verdict_reason", "stalled_at", "stalled_bird"),
}


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    configuration = FlockConfiguration(
        birds=5, t_max=200.0, record_every=4, span_ratios=("2=1.0,1.02",)
    )
    return record(tmp_path_factory.mktemp("flight") / "run", configuration)


def test_the_json_is_the_contract(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_tool(tool, [str(run), "--json"]) == 0
    told = capsys.readouterr()
    assert told.err == ""
    metrics = json.loads(told.out)
    assert metrics.keys() >= KEYS
    assert (metrics["birds"], metrics["members"], metrics["leader"]) == (5, 2, 3)
    assert (metrics["coupling"], metrics["dt"]) == ("nearest", 1.0)
    assert (metrics["steps"], metrics["t_final"]) == (200, 200.0)
    with Run(run) as recorded:
        assert metrics["state_digest"] == recorded.state_digest is not None
    shapes = {
        **dict.fromkeys(("mean_speed", "speed_std", "stable"), (2,)),
        **dict.fromkeys(("mean_drag_reduction", "hierarchical", "profile_error"), (2,)),
        **dict.fromkeys(("verdict", "verdict_reason", "stalled_at", "stalled_bird"), (2,)),
        **dict.fromkeys(("position", "lateral", "drag_reduction"), (2, 5)),
        "spacing": (2, 4),
    }
    assert {key: np.shape(metrics[key]) for key in shapes} == shapes


def test_any_recorded_time_can_be_asked_for(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with Run(run) as whole:
        snapshots = list(whole.snapshots())
    for snapshot in snapshots:
        assert run_tool(tool, [str(run), "--json", "--at", f"{snapshot.time:g}"]) == 0
        metrics = json.loads(capsys.readouterr().out)
        assert (metrics["steps"], metrics["t_final"]) == (snapshot.step, snapshot.time)
        np.testing.assert_allclose(metrics["mean_speed"], snapshot.speed.mean(axis=0), rtol=1e-15)


def test_a_bag_cut_short_is_measured_where_it_is_whole(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    torn = tmp_path / "torn"
    shutil.copytree(run, torn)
    (torn / "metadata.yaml").unlink()
    assert run_tool(tool, [str(torn), "--json"]) == 0
    told = capsys.readouterr()
    assert json.loads(told.out)["steps"] == 200
    assert told.err.count("\n") == 1
    assert "not complete" in told.err


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["nowhere"], "nowhere"),
        (["empty"], "empty"),
        (["empty.mcap"], "empty.mcap"),
        (["foreign.mcap"], "foreign.mcap"),
        ([], "RUN"),
        (["RUN", "--at", "2"], "multiples of 4 up to 200"),
        (["RUN", "--at", "204"], "multiples of 4 up to 200"),
        (["RUN", "--at", "nan"], "--at nan"),
        (["RUN", "--at", "-4"], "--at"),
        (["RUN", "--at", "late"], "--at late"),
        (["RUN", "--nonsense"], "--nonsense"),
    ],
)
def test_bad_input_is_one_line_and_status_2(
    run: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    named: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("empty").mkdir()
    Path("empty.mcap").touch()
    Path("foreign.mcap").write_bytes(b"no bag at all")
    arguments = [str(run) if argument == "RUN" else argument for argument in arguments]
    assert run_tool(tool, arguments) == 2
    told = capsys.readouterr()
    assert told.out == ""
    assert told.err.count("\n") == 1
    assert named in told.err


WITHOUT_ROS = """
import sys

class Absence:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {"rclpy", "flock_interfaces", "std_msgs", "rosgraph_msgs"}:
            raise ModuleNotFoundError(f"{name} is imported")

sys.meta_path.insert(0, Absence())
from flock_sim.console.arguments import run_tool
from flock_tools.commands import compare
from flock_tools.runs import dataset
from flock_tools.commands import metrics
from flock_tools.commands import picture

path, output = sys.argv[1:]
assert run_tool(metrics.tool, [path]) == 0
assert run_tool(compare.tool, [path, path]) == 0
assert run_tool(picture.tool, [path, "--output", output]) == 0
assert dataset.load(path).sizes["time"] == 51
"""


def test_the_tools_work_without_ros(run: Path, tmp_path: Path) -> None:
    ended = subprocess.run(
        [sys.executable, "-c", WITHOUT_ROS, str(run), str(tmp_path / "picture.png")],
        capture_output=True,
        text=True,
        check=False,
    )
    assert ended.returncode == 0, ended.stderr
