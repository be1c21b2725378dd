# SPDX-License-Identifier: Apache-2.0
"""A picture shows the positions of the birds, to scale, for any state of the flock."""

from dataclasses import replace
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.collections import PolyCollection

from flock_sim.bag.directory import belongs_to_bag
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.console.arguments import run_tool
from flock_sim.messages.types import State
from flock_sim.recording.run import Run
from flock_tools.commands import picture
from flock_tools.commands.picture import tool
from flock_tools.figures import output as output_module
from flock_tools.figures import run_history
from flock_tools.figures.run_history import draw
from flock_tools.figures.style import DRAG_SAVED
from flock_tools.runs.dataset import read
from support.flights import Change, keep, record
from support.legibility import cut_off, overlaps

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
    numbers = {text.get_text() for text in figure.axes[0].texts if text.get_visible()}
    assert {"1", str(birds // 2 + 1), str(birds)} <= numbers
    assert not overlaps(figure)


UNEQUAL = ("1=0.1", "2=1", "3=0.1", "4=3", "5=0.2", "8=4", "11=0.5", "12=0.6")


@pytest.mark.parametrize("birds", [13, 101])
def test_labels_of_very_unequal_birds_do_not_overlap(birds: int, tmp_path: Path) -> None:
    flown = FlockConfiguration(birds=birds, t_max=10.0, span_ratios=UNEQUAL)
    figure = drawn(record(tmp_path / "run", flown))
    assert not overlaps(figure)
    assert not cut_off(figure)
    told = {text.get_text() for text in figure.axes[0].texts if text.get_visible()}
    assert {"1", str(birds // 2 + 1), str(birds)} <= told


def marked(figure, mark: str) -> list[tuple[float, float]]:
    """Where a mark is drawn, in any panel of the formation."""
    panels = (figure.axes[0], *figure.axes[0].child_axes)
    lines = [line for panel in panels for line in panel.lines if line.get_marker() == mark]
    return [(float(x), float(y)) for line in lines for x, y in line.get_xydata()]


def test_larger_and_smaller_birds_are_marked_ahead_of_them(flight: Path) -> None:
    with Run(flight) as run:
        metrics = run.metrics()
    for member, larger in ((1, []), (2, [1])):
        figure = drawn(flight, member)
        for mark, birds in (("+", larger), ("_", [5])):
            found = marked(figure, mark)
            assert [x for x, _ in found] == [metrics.lateral[member - 1][i] for i in birds]
            assert all(y > metrics.position[member - 1][i] for (_, y), i in zip(found, birds))
        told = " ".join(text.get_text() for text in figure.axes[0].texts)
        assert ("larger bird" in told) == bool(larger)
        assert "smaller bird" in told


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


def panels_of(figure) -> list:
    """The panels of the parts of a formation, the main one first."""
    return [figure.axes[0], *figure.axes[0].child_axes]


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("birds", [2, 7, 13, 101])
@pytest.mark.parametrize("far", [500.0, -500.0, 99_000.0])
def test_each_part_of_a_flock_is_drawn_to_scale_with_its_numbers(
    tmp_path: Path, birds: int, far: float
) -> None:
    flown = FlockConfiguration(birds=birds, t_max=10.0)
    path = record(tmp_path / "run", flown, parted(birds, far))
    figure = drawn(path)
    assert not overlaps(figure)
    assert not cut_off(figure)
    with Run(path) as run:
        metrics = run.metrics()
    main, other = panels_of(figure)
    scales, shown = [], []
    for panel in (main, other):
        box = panel.get_window_extent()
        scales.append(box.width / np.ptp(panel.get_xlim()))
        assert box.height / np.ptp(panel.get_ylim()) == pytest.approx(scales[-1], rel=1e-6)
        wings = [c for c in panel.collections if isinstance(c, PolyCollection)][-1]
        shown += [path.vertices for path in wings.get_paths()]
    assert scales[0] == pytest.approx(scales[1], rel=1e-6)
    assert other.get_window_extent().x0 == pytest.approx(main.get_window_extent().x0)
    ahead = other.get_ylim()[0] > main.get_ylim()[1]
    above = other.get_window_extent().y0 > main.get_window_extent().y1
    assert ahead == above
    assert len(shown) == birds
    middles = sorted(0.5 * (wing[:, 0].min() + wing[:, 0].max()) for wing in shown)
    assert middles == pytest.approx(metrics.lateral[0])
    written = [text for panel in (main, other) for text in panel.texts if text.get_visible()]
    numbers = {text.get_text() for text in written}
    assert {"1", str(birds // 2 + 1), str(birds)} <= numbers
    assert figure.get_figheight() < 2.2 * figure.get_figwidth()


def test_what_is_left_out_between_two_parts_is_told(tmp_path: Path) -> None:
    flown = FlockConfiguration(birds=4, t_max=10.0)
    main, other = panels_of(drawn(record(tmp_path / "run", flown, parted(4, 500.0))))
    left_out = max(
        other.get_ylim()[0] - main.get_ylim()[1], main.get_ylim()[0] - other.get_ylim()[1]
    )
    told = " ".join(text.get_text() for text in other.texts)
    assert f"{left_out:.0f} b not shown" in told


def scattered(bird: int, state: State) -> State:
    return replace(state, position=state.position + 300.0 * bird * bird)


@pytest.mark.parametrize("birds", [13, 101])
def test_a_scattered_flock_has_a_page_of_usual_size(birds: int, tmp_path: Path) -> None:
    flown = FlockConfiguration(birds=birds, t_max=10.0)
    figure = drawn(record(tmp_path / "run", flown, scattered))
    assert figure.get_figheight() < 2.6 * figure.get_figwidth()
    assert not overlaps(figure)
    assert not cut_off(figure)
    told = " ".join(text.get_text() for text in figure.axes[0].texts)
    assert " at " in told


def test_a_scale_of_spacings_that_is_not_linear_says_so(tmp_path: Path) -> None:
    flown = FlockConfiguration(birds=4, t_max=10.0)
    for far, scale, told in ((0.0, "linear", ""), (500.0, "symlog", "logarithmic beyond 10 b")):
        spacings = drawn(record(tmp_path / f"{far}", flown, parted(4, far))).axes[-1]
        assert spacings.get_ylabel().startswith("spacing")
        assert spacings.get_yscale() == scale
        assert told in spacings.get_title("left")


def test_the_title_tells_the_links(tmp_path: Path) -> None:
    flown = FlockConfiguration(birds=3, t_max=10.0, links=("linear:delay=2,drop=0.1",))
    title = drawn(record(tmp_path / "run", flown)).get_suptitle()
    assert "links: linear with delay 2 steps, probability of loss 0.1" in title


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


def test_each_member_has_a_picture_of_its_own(
    flight: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for member, name in ((1, "formation.png"), (2, "formation_member_2.png")):
        assert run_tool(tool, [str(flight), "--member", str(member)]) == 0
        assert capsys.readouterr().out == f"{flight / name}\n"
        assert (flight / name).read_bytes().startswith(PNG)
        assert belongs_to_bag(name)
    pictures = [(flight / name).read_bytes() for name in ("formation.png", name)]
    assert pictures[0] != pictures[1]
    for other in ("formation_member_.png", "formation_member_0.png", "formation_member_2.pdf"):
        assert not belongs_to_bag(other)


def test_the_curves_of_a_long_run_reach_its_end(
    flight: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run_history, "MOST_TIMES", 4)  # every third of the eleven rows
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


def test_the_time_of_the_formation_is_marked_in_the_curves(flight: Path) -> None:
    for time, told in ((0.0, True), (50.0, True), (None, False)):
        with Run(flight) as run:
            metrics, verdicts = run.metrics(time), run.verdicts(time)
            means = run.time_means(metrics.t_final)
            history = read(run).sel(member=1)
            figure = draw(run.configuration, metrics, means, verdicts, history, 1)
        curves = [axes for axes in figure.axes if "time" in axes.get_xlabel()]
        dotted = [line for axes in curves for line in axes.lines if line.get_linestyle() == ":"]
        assert [line.get_xdata()[0] for line in dotted] == [time] * (2 * told)
        written = {text.get_text() for text in curves[0].texts}
        assert (f"formation above: t = {time or 0:g}" in written) == told
        assert not overlaps(figure)
        assert not cut_off(figure)


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
