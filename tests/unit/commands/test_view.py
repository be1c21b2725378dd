# SPDX-License-Identifier: Apache-2.0
"""`view` draws the scene that it would publish, and refuses impossible options in one line."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.collections import PolyCollection, TriMesh
from matplotlib.figure import Figure

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.console.arguments import run_tool
from flock_sim.messages.state import ARRAYS
from flock_sim.messages.types import State
from flock_sim.recording.run import Run
from flock_tools.commands.view import period, tool
from flock_tools.figures import output as output_module
from flock_tools.scene.bird_mesh import BIRD
from flock_tools.scene.camera import Camera
from flock_tools.scene.panel import polygons
from flock_tools.scene.picture import FINE_ROWS, MOST_INSETS, draw_scene, scene_of
from flock_tools.scene.shapes import scene
from flock_tools.scene.wake import PLANE_ROWS
from support.flights import Change, keep, record
from support.legibility import cut_off, overlaps
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


def drawn(tmp_path: Path, flown: FlockConfiguration, change: Change = keep) -> Figure:
    with Run(record(tmp_path / "run", flown, change)) as run:
        return draw_scene(scene_of(run, None, 0))


def test_air_has_smooth_opaque_colours_of_which_rising_is_darker(flight: Path) -> None:
    with Run(flight) as run:
        shown = scene_of(run, None, 1, FINE_ROWS)
    figure = draw_scene(shown)
    plane, wakes = (c for c in figure.axes[0].collections if isinstance(c, TriMesh))
    assert shown.upwash.shape[0] == FINE_ROWS > PLANE_ROWS
    colours = plane.get_facecolor()
    assert (colours[:, 3] == 1.0).all()
    assert (wakes.get_facecolor()[:, 3] == 1.0).all()
    lightness = colours[:, :3] @ (0.2126, 0.7152, 0.0722)
    upwash = shown.upwash.ravel()
    still = np.abs(upwash) < 0.01 * shown.most_upwash
    assert lightness[upwash > 0.1].max() < lightness[still].min()
    assert lightness[still].max() < lightness[upwash < -0.1].min()


def test_a_picture_has_a_bar_and_the_direction_of_flight(flight: Path) -> None:
    with Run(flight) as run:
        figure = draw_scene(scene_of(run, None, 1))
    told = {text.get_text().strip() for text in figure.axes[0].texts}
    assert {"1 m", "flight"} <= told


def test_labels_tell_other_spans_and_the_title_the_links(tmp_path: Path) -> None:
    flown = FlockConfiguration(birds=5, t_max=10.0, span_ratios=("2=0.9",), links=("hold:delay=3",))
    figure = drawn(tmp_path, flown)
    spans = [text for text in figure.axes[0].texts if "lambda" in text.get_text()]
    assert [text.get_text().strip() for text in spans] == ["$\\lambda$ = 0.9"]
    (label,) = (text for text in figure.axes[0].texts if text.get_text().startswith("2\n"))
    assert spans[0].xy == label.xy
    assert spans[0].get_visible()
    assert "links: hold with delay 3 steps" in figure.texts[0].get_text()


@pytest.mark.parametrize("birds", [1, 2, 7, 13, 101])
def test_labels_of_any_flock_do_not_overlap(tmp_path: Path, birds: int) -> None:
    spans = ("1=0.1", "3=0.1", "4=3", "5=0.2") if birds > 10 else ()
    figure = drawn(tmp_path, FlockConfiguration(birds=birds, t_max=10.0, span_ratios=spans))
    assert not overlaps(figure)
    assert not cut_off(figure)
    shown = [text for text in figure.axes[0].texts if text.get_visible()]
    told = {text.get_text().partition("\n")[0] for text in shown}
    assert {"1", str(birds // 2 + 1), str(birds)} <= told
    assert len(told) > min(birds, 10)


def moved(first: int, far: float) -> Change:
    return lambda bird, state: (
        replace(state, position=state.position + far) if bird >= first else state
    )


@pytest.mark.parametrize("far", [400.0, -400.0, 1e8])
@pytest.mark.parametrize(("birds", "first"), [(2, 2), (13, 10), (13, 13), (101, 90)])
def test_a_part_that_is_far_away_is_an_inset(
    tmp_path: Path, birds: int, first: int, far: float
) -> None:
    figure = drawn(tmp_path, FlockConfiguration(birds=birds, t_max=10.0), moved(first, far))
    assert not overlaps(figure)
    assert not cut_off(figure)
    # The two parts of two birds are equally large: the upper one is drawn first.
    main, inset = figure.axes[:2]
    faces = [
        len(next(c for c in axes.collections if type(c) is PolyCollection).get_paths())
        for axes in (main, inset)
    ]
    assert sum(faces) == birds * len(BIRD)
    assert faces[0] == len(BIRD) * max(first - 1, birds - first + 1)
    caption = figure.texts[1].get_text()
    assert caption.startswith("bird")
    assert ("ahead of" in caption) != ("behind" in caption)
    assert figure.get_figheight() < 1.6 * figure.get_figwidth()


def test_a_scattered_flock_has_the_largest_parts_and_lists_the_other_birds(tmp_path: Path) -> None:
    def scattered(bird: int, state: State) -> State:
        return replace(state, position=state.position + 300.0 * bird * bird)

    figure = drawn(tmp_path, FlockConfiguration(birds=13, t_max=10.0), scattered)
    told = [text.get_text() for text in figure.texts]
    assert "far from all others,\nnot drawn:" in told
    assert len([text for text in told if "the leader" in text]) == MOST_INSETS
    labels = [*told, *(text.get_text() for axes in figure.axes for text in axes.texts)]
    numbers = sorted(int(text.split("\n")[0]) for text in labels if re.match(r"\d+\n", text))
    assert numbers == list(range(1, 14))
    assert figure.get_figheight() < 2.0 * figure.get_figwidth()
    assert not overlaps(figure)
    assert not cut_off(figure)


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
        (["--force"], ["--force", "--output"]),
        (["--output", "scene"], ["--output scene", "RUN"]),
        (["--output", "scene", "none"], ["none"]),
        (["--output", "scene", "--picture", "a.png", "FLIGHT"], ["--picture", "exclude"]),
        (["--output", "scene", "--foxglove", "0", "FLIGHT"], ["--foxglove", "exclude"]),
        (["--output", "scene", "--at", "3", "FLIGHT"], ["--at 3", "--picture"]),
        (["--output", "scene", "--rate", "61", "FLIGHT"], ["--rate 61", "60 or less"]),
        (["--output", "scene", "--member", "3", "FLIGHT"], ["--member 3", "1..2"]),
        (["--output", ".", "FLIGHT"], ["output .", "exists", "--force"]),
        (["--output", "/proc/none/scene", "FLIGHT"], ["/proc/none/scene", "can't be written"]),
        (["--picture", "a.xyz", "FLIGHT"], ["--picture a.xyz", "png"]),
        (["--picture", "a.png", "--foxglove", "0", "FLIGHT"], ["exclude"]),
        (["--picture", "a.png", "--odometry", "FLIGHT"], ["--odometry", "exclude"]),
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
