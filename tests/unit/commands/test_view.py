# SPDX-License-Identifier: Apache-2.0
"""`view` draws the scene that it would publish, and refuses impossible options in one line."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.collections import PolyCollection

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.console.arguments import run_tool
from flock_sim.messages.state import ARRAYS
from flock_sim.messages.types import State
from flock_sim.recording.run import Run
from flock_tools.commands.view import period, tool
from flock_tools.figures import output as output_module
from flock_tools.scene.picture import Camera, draw_scene, polygons, scene_of
from flock_tools.scene.shapes import scene
from support.flights import record
from unit.scene.test_shapes import snapshot

TWO = FlockConfiguration(birds=3, t_max=40.0, span_ratios=("1=0.9,1.0",))


@pytest.fixture(autouse=True)
def _coarse(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(output_module, "RESOLUTION", 40)


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("flight") / "run", TWO)


def test_a_picture_is_written_and_named(
    flight: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "scene.png"
    assert run_tool(tool, ["--picture", str(output), "--member", "2", str(flight)]) == 0
    assert capsys.readouterr().out == f"{output}\n"
    assert output.read_bytes().startswith(b"\x89PNG")


def test_all_of_the_scene_is_on_the_picture(flight: Path) -> None:
    with Run(flight) as run:
        figure = draw_scene(scene_of(run, 20.0, 0))
    figure.draw_without_rendering()
    axes = figure.axes[0]
    for collection in axes.collections:
        if isinstance(collection, PolyCollection):
            for path in collection.get_paths():
                assert (path.vertices >= 0.0).all()
                assert (path.vertices <= (axes.get_xlim()[1], axes.get_ylim()[1])).all()
    assert {text.get_text().partition("\n")[0] for text in axes.texts} >= {"1", "2", "3"}


def test_trails_come_from_the_bag(flight: Path) -> None:
    with Run(flight) as run:
        shown = scene_of(run, None, 1)
        start = run.at(0.0).position[:, 1]
    (trail,) = [shape for shape in shown.shapes if (shape.group, shape.number) == ("trails", 1)]
    assert trail.points[0, 0] == pytest.approx(0.75 * (start[0] - start[1]))


def test_what_is_nearer_is_seen_larger_and_what_is_right_on_the_right() -> None:
    birds = [shape for shape in scene(snapshot()).shapes if shape.group == "birds"]
    camera = Camera.at(birds)
    to_left = np.array([[0.0, 1.0, 0.0], [0.0, -1.0, 0.0]])
    seen, _ = camera.see(to_left)
    assert seen[0, 0] > seen[1, 0]  # seen from in front
    near, far = (np.ptp(camera.see(to_left + (x, 0.0, 0.0))[0][:, 0]) for x in (2.0, -2.0))
    assert near > far
    assert polygons(birds[0]).shape[1:] == (3, 3)


@pytest.mark.parametrize("value", [1e200, np.nan, np.inf])
def test_a_diverged_flock_is_drawn_as_far_as_it_has_finite_states(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], value: float
) -> None:
    def diverged(bird: int, state: State) -> State:
        return replace(state, **{name: getattr(state, name) * value for name in ARRAYS})

    path = record(tmp_path / "run", FlockConfiguration(birds=4, t_max=10.0), diverged)
    assert run_tool(tool, ["--picture", str(tmp_path / "scene.png"), str(path)]) == 0
    assert capsys.readouterr().err == ""
    with Run(path) as run:
        figure = draw_scene(scene_of(run, None, 0))
    words = [text.get_text() for text in figure.texts]
    assert ("no bird has a finite position and circulation" in words) == (not np.isfinite(value))


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--rate", "0"], ["--rate 0", "above 0"]),
        (["--rate", "-1"], ["--rate -1", "above 0"]),
        (["--rate", "nan"], ["--rate nan", "above 0"]),
        (["--rate", "1000"], ["--rate 1000", "60 or less"]),
        (["--member", "0"], ["--member 0", "1 or more"]),
        (["--timeout", "0"], ["--timeout 0", "above 0"]),
        (["--foxglove", "70000"], ["--foxglove 70000", "0..65535"]),
        (["--foxglove", "some"], ["--foxglove some", "0..65535"]),
        (["--host", "0.0.0.0"], ["--host 0.0.0.0", "--foxglove"]),
        (
            ["--foxglove-origin", "https://a.example"],
            ["--foxglove-origin https://a.example", "both"],
        ),
        (["--foxglove", "--foxglove-origin", "*"], ["--foxglove-origin *", "https://HOST"]),
        (["--foxglove", "--foxglove-origin", "https://a/b"], ["https://a/b", "https://HOST"]),
        (["--at", "3"], ["--at 3", "--picture"]),
        (["--picture", "a.png"], ["--picture a.png", "RUN"]),
        (["--config", "none.yaml"], ["none.yaml"]),
        (["FLIGHT"], ["RUN", "play"]),
        (["--picture", "a.xyz", "FLIGHT"], ["--picture a.xyz", "png"]),
        (["--picture", "a.png", "--foxglove", "0", "FLIGHT"], ["exclude"]),
        (["--picture", "a.png", "--member", "3", "FLIGHT"], ["--member 3", "1..2"]),
        (["--picture", "a.png", "--at", "7", "FLIGHT"], ["time 7", "not recorded"]),
    ],
)
def test_bad_input_is_said_in_one_line(
    arguments: list[str],
    words: list[str],
    flight: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    given = [str(flight) if argument == "FLIGHT" else argument for argument in arguments]
    assert run_tool(tool, given) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("error: ")
    assert err.count("\n") == 1
    assert all(word in err for word in words)


@pytest.mark.parametrize(("rate", "seconds"), [(20.0, 0.05), (1e-8, 1e8), (5e-324, 1e9)])
def test_any_rate_is_one_that_can_be_waited_for(rate: float, seconds: float) -> None:
    assert period(rate) == pytest.approx(seconds)
