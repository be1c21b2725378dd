# SPDX-License-Identifier: Apache-2.0
"""A sweep that the reference flies has the results of the flights, to the bit, and goes on."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
import yaml
from distributed import LocalCluster

from flock_sim.console.arguments import run_tool
from flock_sim.errors import FlockError
from flock_tools.commands.sweep import tool
from flock_tools.experiments.sweep import by_reference, specification
from flock_tools.experiments.sweep.by_reference import fly_by_reference, fly_parts
from flock_tools.experiments.sweep.dataset import dataset, layout, recorded
from flock_tools.experiments.sweep.directory import SweepDirectory
from flock_tools.experiments.sweep.specification import Sweep, sweep
from support.flights import record
from support.hanging import not_hanging
from support.python_process import python
from support.tool_runs import error_of

AXES: dict[str, list[Any]] = {
    "span_ratio[2]": [0.95, 1.0, 1.3],
    "speed[1]": [0.0, 0.01, -1.5],
    "link.interval": [1, 3],
    "t_max": [2000, 1000],
}
FLOCK = {
    "birds": 3,
    "links": ["hold:drop=0.2,delay=1"],
    "forcing": ["gust:std=1e-4"],
    "perturbations": ["3@500=0.1"],
}


def swept(birds: int = 3, **axes: Any) -> Sweep:
    return sweep({"flock": {**FLOCK, "birds": birds}, "axes": axes or AXES})


def over_bags(asked: Sweep, directory: Path, at_once: int) -> xr.Dataset:
    """The dataset of a sweep from the bags of its flights."""
    flights = asked.flights(at_once)
    bags = [SweepDirectory(directory).bag(flight) for flight in flights]
    for flight, bag in zip(flights, bags, strict=True):
        record(bag, flight.configuration)
    return dataset(asked, recorded(asked, flights, bags), "")


@pytest.mark.parametrize("at_once", [4, 7, 250])
@pytest.mark.parametrize("birds", [1, 2, 11])
def test_the_dataset_is_that_of_the_bags_to_the_bit(
    birds: int, at_once: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(specification, "LANES", 3)
    monkeypatch.setattr(by_reference, "PAIR_STEPS", 1000)
    axes = AXES if birds > 1 else {key: AXES[key] for key in ("speed[1]", "t_max")}
    flock = {**FLOCK, "birds": birds, "perturbations": ["1@500=0.1"]}
    asked = sweep({"flock": flock, "axes": axes})
    found = fly_by_reference(asked, at_once=at_once)
    expected = over_bags(asked, tmp_path, at_once)
    assert found.identical(expected)
    for name, variable in expected.variables.items():
        assert found[name].values.tobytes() == variable.values.tobytes(), name
    assert len(set(found.verdict.values.ravel())) > 1


class Interrupted(BaseException):
    """Ctrl-C."""


def flown_before(raises: int, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Any]:
    """`fly_members` that is interrupted at its call number `raises`, and before that works."""
    calls = iter(range(raises))
    real = by_reference.fly_members

    def fly(*arguments: Any) -> Any:
        if next(calls, None) is None:
            raise Interrupted
        return real(*arguments)

    monkeypatch.setattr(by_reference, "fly_members", fly)
    return real


@pytest.mark.parametrize("save_every", [0.0, 1e9], ids=["after each part", "at the end"])
def test_an_interrupted_sweep_flies_the_rest_only(
    save_every: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(by_reference, "SAVE_EVERY", save_every)
    monkeypatch.setattr(specification, "LANES", 1)
    asked = swept()
    with monkeypatch.context() as patched:
        flown_before(9, patched)
        with pytest.raises(Interrupted):
            fly_by_reference(asked, tmp_path)
    assert not (tmp_path / "sweep.nc").exists()
    parts = asked.parts(250)
    directory = SweepDirectory(tmp_path)
    _, rest = fly_parts(asked, parts, directory, None)
    assert 1 <= len(parts) - len(rest) <= 9
    found = fly_by_reference(asked, tmp_path)
    assert fly_parts(asked, parts, directory, None)[1] == []
    assert found.identical(fly_by_reference(asked))
    with xr.open_dataset(tmp_path / "sweep.nc", engine="scipy") as written:
        assert written.identical(found)


def test_a_long_flight_of_one_member_is_halted(monkeypatch: pytest.MonkeyPatch) -> None:
    # The other part fails at once. Without a halt, this test would take hours.
    monkeypatch.setattr(specification, "LANES", 1)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1})  # also on one core
    real = flown_before(1, monkeypatch)
    asked = sweep(
        {"flock": {"birds": 3, "t_max": 1e9, "record_every": 10**9}, "axes": {"speed[1]": [0, 1]}}
    )
    with pytest.raises(Interrupted):
        fly_by_reference(asked)
    assert by_reference.fly_members is not real


def test_a_part_is_small_if_it_has_many_records() -> None:
    given = {"flock": {"birds": 13, "t_max": 1e6, "record_every": 1}, "axes": {"speed[1]": [0, 1]}}
    assert [part.members for part in sweep(given).parts(250)] == [(0,), (1,)]
    given["flock"] |= {"record_every": 5000}  # type: ignore[operator]
    assert [part.members for part in sweep(given).parts(250)] == [(0, 1)]


def run(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    """The exit status of the tool, and its output on stdout and stderr."""
    status = run_tool(tool, [*arguments, "--json"])
    return status, *capsys.readouterr()


def test_the_tool_continues_a_sweep_of_the_reference_and_no_other(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "s.yaml"
    file.write_text(yaml.safe_dump({"flock": FLOCK, "axes": AXES}, sort_keys=False))
    command = (str(file), "--output", str(tmp_path / "out"), "--members-at-once", "7")
    first = json.loads(run(capsys, *command, "--reference")[1])
    assert first["flights_flown"] == first["flights"] > 4
    assert first["reference"] is True
    assert (tmp_path / "out/sweep.png").exists()
    with xr.open_dataset(tmp_path / "out/sweep.nc", engine="scipy") as found:
        assert "--reference" in found.attrs["command"]
        assert found.drop_attrs().identical(fly_by_reference(swept(), at_once=7).drop_attrs())
    _, told, notes = run(capsys, *command, "--reference")
    assert json.loads(told)["flights_flown"] == 0
    assert "there is nothing left to fly" in notes
    assert "holds another sweep" in error_of(tool, capsys, *command)
    (tmp_path / "out/sweep.npz").write_bytes(b"PK damaged")
    status, _, notes = run(capsys, *command, "--reference")
    assert status == 2
    assert "sweep.npz can't be read" in notes
    _, told, _ = run(capsys, *command, "--reference", "--force")
    assert json.loads(told)["flights_flown"] == first["flights"]


@pytest.mark.parametrize("birds", [1, 2, 3])
def test_results_have_the_layout_with_which_they_are_read(birds: int) -> None:
    axes = {"speed[1]": [0.0, 0.01]}
    asked = sweep({"flock": {"birds": birds, "t_max": 20.0}, "axes": axes})
    values, _ = fly_parts(asked, asked.parts(250), None, None)
    flown = {"flown": np.zeros(2, dtype=bool)}
    found = {name: (array.dtype.type, array.shape) for name, array in (flown | values).items()}
    assert found == layout(2, birds)


@pytest.mark.parametrize(
    "change",
    [
        {"flown": np.ones(3, dtype=bool)},
        {"flown": np.ones(2, dtype=object)},
        {"position": np.zeros((2, 4))},
        {"speed": np.array([["a"] * 3] * 2, dtype=object)},
        {"verdict": np.full(2, 100, dtype=np.int8)},
        {"verdict": np.full(2, -1, dtype=np.int8)},
        {"other": np.zeros(2)},
    ],
    ids=range(7),
)
def test_results_that_do_not_fit_are_refused_with_the_remedy(
    change: dict[str, Any], tmp_path: Path
) -> None:
    asked = sweep({"flock": {"birds": 3, "t_max": 20.0}, "axes": {"speed[1]": [0.0, 0.01]}})
    fly_by_reference(asked, tmp_path)
    file = tmp_path / "sweep.npz"
    with np.load(file) as stored:
        sound = dict(stored)
    np.savez(file, **sound)
    assert fly_parts(asked, asked.parts(250), SweepDirectory(tmp_path), None)[1] == []
    np.savez(file, **(sound | change))
    with pytest.raises(
        FlockError, match=r"sweep\.npz can't be read \(.*\): replace the sweep with"
    ):
        fly_by_reference(asked, tmp_path)


@pytest.mark.parametrize("kind", ["directory", "pipe", "truncated", "one array"])
def test_results_that_are_no_results_are_refused_in_one_line(
    kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, out = tmp_path / "s.yaml", tmp_path / "out"
    flock = {"birds": 2, "t_max": 20.0}
    file.write_text(yaml.safe_dump({"flock": flock, "axes": {"speed[1]": [0.0]}}))
    command = (str(file), "--output", str(out), "--reference")
    assert run(capsys, *command)[0] == 0
    results = out / "sweep.npz"
    content = results.read_bytes()
    results.unlink()
    if kind == "directory":
        results.mkdir()
    elif kind == "pipe":
        os.mkfifo(results)
    elif kind == "truncated":
        results.write_bytes(content[: len(content) // 2])
    else:
        with results.open("wb") as written:
            np.save(written, np.zeros(3))
    with not_hanging():
        status, told, notes = run(capsys, *command)
    assert (status, told) == (2, "")
    assert notes.count("error: ") == 1
    assert "sweep.npz can't be read (" in notes.splitlines()[-1]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ("--reference --processes 2", "--processes is for flights over ROS 2: leave it out"),
        ("--reference --timeout 2", "--timeout is for flights over ROS 2: leave it out"),
        ("--scheduler tcp://127.0.0.1:9", "--scheduler is for --reference: add --reference"),
        ("--reference --scheduler nowhere", "must be an address such as tcp://127.0.0.1:8786"),
    ],
)
def test_options_of_the_other_way_are_refused(
    arguments: str, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "s.yaml"
    file.write_text(yaml.safe_dump({"flock": FLOCK, "axes": {"span_ratio[1]": [1.0]}}))
    output = ("--output", str(tmp_path / "out"))
    status, told, notes = run(capsys, str(file), *output, *arguments.split())
    assert (status, told) == (2, "")
    assert words in notes


def test_another_law_in_the_same_file_is_another_sweep(tmp_path: Path) -> None:
    file = tmp_path / "laws.py"

    def asked(text: str) -> Sweep:
        file.write_text(text)
        forcing = [f"{file}:push:strength=1e-5"]
        flock = {"birds": 2, "t_max": 20.0, "forcing": forcing}
        return sweep({"flock": flock, "axes": {"speed[1]": [0.0]}})

    text = "def push(strength):\n    return strength"
    found = fly_by_reference(asked(f"{text}\n"), tmp_path / "out")
    assert fly_by_reference(asked(f"{text}\n"), tmp_path / "out").identical(found)
    with pytest.raises(FlockError, match="holds another sweep"):
        fly_by_reference(asked(f"{text} * 2.0\n"), tmp_path / "out")


@pytest.mark.slow
def test_a_cluster_flies_the_same_bits(tmp_path: Path) -> None:
    asked = swept()
    with LocalCluster(
        n_workers=2,
        threads_per_worker=1,
        host="127.0.0.1",
        dashboard_address=None,
        local_directory=str(tmp_path),
    ) as cluster:
        there = fly_by_reference(asked, scheduler=cluster.scheduler_address)
    assert there.identical(fly_by_reference(asked))


FLY = """
import sys

class Absence:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in sys.argv[1].split():
            raise ModuleNotFoundError(name)

sys.meta_path.insert(0, Absence())

from pathlib import Path
from flock_tools.experiments.sweep.by_reference import fly_by_reference
from flock_tools.experiments.sweep.specification import sweep

asked = sweep({"flock": {"birds": 3, "t_max": 100.0}, "axes": {"link.delay": [0, 1]}})
print(fly_by_reference(asked, Path(sys.argv[2])).mean_speed.size)
"""


def test_it_needs_neither_ros_nor_its_messages(tmp_path: Path) -> None:
    absent = "rclpy flock_interfaces ament_index_python rosgraph_msgs std_msgs launch matplotlib"
    assert python(FLY, absent, str(tmp_path / "out")).split() == ["2"]
    assert np.load(tmp_path / "out/sweep.npz")["flown"].all()
