# SPDX-License-Identifier: Apache-2.0
"""A picture shows the positions of the birds, to scale, for any state of the flock."""

from dataclasses import replace
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.collections import PolyCollection

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.console.arguments import run_tool
from flock_sim.recording.run import Run
from flock_tools.commands import picture
from flock_tools.commands.picture import tool
from flock_tools.figures import output as output_module
from flock_tools.figures.run_history import draw
from flock_tools.figures.style import DRAG_SAVED
from flock_tools.runs.dataset import read
from support.flights import Change, keep, record

PNG = b"\x89PNG\r\n\x1a\n"
HETEROGENEOUS = FlockConfiguration(birds=7, t_max=100.0, span_ratios=("2=1.0,1.3", "6=0.8"))


@pytest.fixture(autouse=True)
def _coarse(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(output_module, "RESOLUTION", 40)


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("flight") / "run", HETEROGENEOUS)


def drawn(path: Path, member: int = 1):
    with Run(path) as run:
        metrics, verdicts = run.metrics(), run.verdicts()
        means = run.time_means(metrics.t_final)
        history = read(run).sel(member=member)
        return draw(run.configuration, metrics, means, verdicts, history, member)


def outlines(figure) -> list[np.ndarray]:
    """The corners of each bird, in b."""
    _, birds = (c for c in figure.axes[0].collections if isinstance(c, PolyCollection))
    return [wing.vertices for wing in birds.get_paths()]


@pytest.mark.parametrize("member", [1, 2])
def test_birds_are_drawn_where_they_are_and_as_wide_as_they_are(flight: Path, member: int) -> None:
    wings = outlines(drawn(flight, member))
    with Run(flight) as run:
        metrics = run.metrics()
    ratio = HETEROGENEOUS.span_ratio[:, member - 1]
    assert len(wings) == 7
    for i, wing in enumerate(wings):
        across = metrics.lateral[member - 1][i]
        assert wing[:, 0].min() == pytest.approx(across - ratio[i], abs=1e-12)
        assert wing[:, 0].max() == pytest.approx(across + ratio[i], abs=1e-12)
        along = metrics.position[member - 1][i]
        assert wing[:, 1].min() < along < wing[:, 1].max()


def test_a_length_is_as_long_across_the_flight_as_along_it(flight: Path) -> None:
    assert drawn(flight).axes[0].get_aspect() == 1.0


@pytest.mark.parametrize("birds", [1, 2, 3, 4, 13, 31, 101])
def test_every_size_of_flock_is_drawn_with_nothing_cut_off(birds: int, tmp_path: Path) -> None:
    path = record(tmp_path / "run", FlockConfiguration(birds=birds, t_max=40.0))
    figure = drawn(path)
    figure.draw_without_rendering()
    inside = figure.bbox
    tight = figure.get_tightbbox().transformed(figure.dpi_scale_trans)
    assert inside.x0 <= tight.x0
    assert tight.x1 <= inside.x1
    assert inside.y0 <= tight.y0
    assert tight.y1 <= inside.y1
    assert len(outlines(figure)) == birds
    numbers = {text.get_text() for text in figure.axes[0].texts}
    assert {"1", str(birds // 2 + 1), str(birds)} <= numbers


def test_the_colours_of_little_and_much_saved_differ_in_grey_print() -> None:
    lightness = DRAG_SAVED(np.linspace(0.0, 1.0, 20))[:, :3] @ (0.2126, 0.7152, 0.0722)
    assert (np.diff(lightness) < 0.0).all()


def lost(bird: int, far: float) -> Change:
    return lambda who, state: (
        replace(state, position=state.position + far) if who == bird else state
    )


def broken(bird: int, value: float) -> Change:
    return lambda who, state: (
        replace(state, position=state.position * value, speed=state.speed * value)
        if who == bird and state.step > 0
        else state
    )


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("change", "shown", "said"),
    [
        (keep, 7, ""),
        (lost(1, -5000.0), 6, "1 at −50"),
        (lost(7, 5000.0), 6, "7 at 49"),
        (lost(4, 5000.0), 6, "4 at 0"),
        (broken(3, np.nan), 6, "without a finite position: 3"),
        (broken(3, np.inf), 6, "without a finite position: 3"),
        (broken(4, np.nan), 0, "no finite position"),
    ],
)
def test_a_flock_that_has_come_apart_is_shown_where_most_of_it_is(
    tmp_path: Path, change: Change, shown: int, said: str
) -> None:
    figure = drawn(record(tmp_path / "run", HETEROGENEOUS, change))
    figure.draw_without_rendering()
    assert len(outlines(figure)) == shown
    assert any(said in text.get_text() for text in figure.axes[0].texts)
    low, high = figure.axes[0].get_ylim()
    assert high - low < 30.0


def parted(birds: int, far: float) -> Change:
    """Move the birds from the leader on by `far`."""
    return lambda who, state: (
        replace(state, position=state.position + far) if who > birds // 2 else state
    )


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("birds", [2, 4, 6])
def test_an_even_flock_that_has_parted_in_halves_is_shown_around_one_half(
    tmp_path: Path, birds: int
) -> None:
    flown = FlockConfiguration(birds=birds, t_max=10.0)
    figure = drawn(record(tmp_path / "run", flown, parted(birds, 500.0)))
    figure.draw_without_rendering()
    assert len(outlines(figure)) == birds // 2
    told = {text.get_text() for text in figure.axes[0].texts}
    for bird in range(1, birds // 2 + 1):
        start = -abs(bird - birds // 2 - 1) * (1.0 + np.pi / 4.0)
        assert any(text.startswith(f"{bird} at −{500.0 - start:.0f}"[:-1]) for text in told)


@pytest.mark.parametrize("far", [1e12, 1e64, 1e200])
def test_birds_at_any_finite_distance_are_named(tmp_path: Path, far: float) -> None:
    flown = FlockConfiguration(birds=5, t_max=10.0)
    figure = drawn(record(tmp_path / "run", flown, broken(3, far)))
    figure.draw_without_rendering()
    assert any("e+" in text.get_text() for text in figure.axes[0].texts)


def test_the_picture_lies_beside_the_bag(flight: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_tool(tool, [str(flight)]) == 0
    told = capsys.readouterr()
    assert told.out == f"{flight / 'formation.png'}\n"
    assert told.err == ""
    assert (flight / "formation.png").read_bytes().startswith(PNG)
    (file,) = flight.glob("*.mcap")
    (flight / "formation.png").unlink()
    assert run_tool(tool, [str(file)]) == 0
    assert (flight / "formation.png").exists()
    with Run(flight) as run:
        assert run.at().step == 100


def test_the_curves_of_a_long_run_reach_its_end(
    flight: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(picture, "MOST_TIMES", 4)  # every third of the eleven rows
    figures = []
    monkeypatch.setattr(picture, "write_picture", lambda figure, output: figures.append(figure))
    assert run_tool(tool, [str(flight), "--output", str(tmp_path / "a.png")]) == 0
    (figure,) = figures
    timed = [axes for axes in figure.axes if "time" in axes.get_xlabel()]
    assert len(timed) == 2
    for axes in timed:
        curve = max(axes.lines, key=lambda line: len(line.get_xdata()))
        assert curve.get_xdata().tolist() == [0.0, 30.0, 60.0, 90.0, 100.0]
        assert axes.get_xlim() == (0.0, 100.0)


def test_moment_member_and_file_can_be_chosen(flight: Path, tmp_path: Path) -> None:
    chosen = ["--at", "50", "--member", "2", "--output"]
    for name, begin in (("a.png", PNG), ("a.pdf", b"%PDF"), ("plain", PNG)):
        assert run_tool(tool, [str(flight), *chosen, str(tmp_path / name)]) == 0
        assert (tmp_path / name).read_bytes().startswith(begin)


def test_the_users_own_settings_of_matplotlib_are_left_alone(flight: Path, tmp_path: Path) -> None:
    before = dict(mpl.rcParams)
    assert run_tool(tool, [str(flight), "--output", str(tmp_path / "a.png")]) == 0
    assert dict(mpl.rcParams) == before


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["nowhere"], "nowhere"),
        (["RUN", "--member", "3"], "--member 3: must be a whole number, 1..2"),
        (["RUN", "--member", "0"], "1..2"),
        (["RUN", "--member", "all"], "--member all"),
        (["RUN", "--at", "55"], "multiples of 10 up to 100"),
        (["RUN", "--output", "no/such/place.png"], "no/such/place.png"),
        (["RUN", "--output", "."], "."),
        (["RUN", "--output", "a.txt"], "a.txt"),
    ],
)
def test_bad_input_is_one_line_and_status_2(
    flight: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    named: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    arguments = [str(flight) if argument == "RUN" else argument for argument in arguments]
    assert run_tool(tool, arguments) == 2
    told = capsys.readouterr()
    assert told.out == ""
    assert told.err.count("\n") == 1
    assert named in told.err
    assert list(tmp_path.iterdir()) == []
