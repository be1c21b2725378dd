# SPDX-License-Identifier: Apache-2.0
"""The paper's figures agree with the model, and are legible in print."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.figure import Figure

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.console.arguments import run_tool
from flock_sim.physics.aerodynamics import even_part, interaction_integral
from flock_sim.physics.flock import Flock
from flock_sim.physics.formation import TIP_SPACING, VORTEX_FRACTION
from flock_sim.theory.equilibrium import equilibrium
from flock_sim.theory.limit_search import End, Limits
from flock_sim.theory.span_limits import exact_limits, modified_birds
from flock_sim.theory.thrust_limits import exact_thrust_limits
from flock_tools.commands.figures import tool
from flock_tools.figures import files
from flock_tools.figures.limits import draw_limits, limits_table
from flock_tools.figures.paper.contributions import CONFIGURATION, contributions, draw_contributions
from flock_tools.figures.paper.modified_bird import (
    CASES,
    draw_modified,
    modified_flocks,
    modified_table,
)
from flock_tools.figures.paper.steady_states import SHOWN, draw_steady, steady_flocks
from flock_tools.figures.style import COLUMN, PAGE, SMALL
from flock_tools.figures.table import Table
from support.legibility import cut_off, overlaps, texts
from support.tool_runs import error_of

FILES = [
    f"figure_{end}"
    for end in (
        *("2.png", "2.svg", "2.csv"),
        *("3.png", "3.svg", "3a.csv", "3bc.csv"),
        *("4.png", "4.svg", "4.csv"),
        *("5.png", "5.svg", "5.csv"),
    )
]
GEESE = FlockConfiguration()
CRUISE = 18.5 / 18.0
ROUNDING = 1e-11
"""Of sums of a few dozen terms, at the spacings to which Newton's method converges."""


@pytest.fixture(scope="module")
def equal():
    return steady_flocks()


@pytest.fixture(scope="module")
def modified():
    return modified_flocks()


def drag(speed, ratio=1.0):
    """D_j over D_0, the drag of a standard bird at its cruising speed."""
    least = CRUISE**2 + CRUISE**-2
    return (ratio**2 * speed**2 + ratio**4 * speed**-2) / least


# Figure 2


def test_contributions_sum_to_1_and_drags_to_what_a_bird_saves() -> None:
    data = contributions()
    assert np.nansum(data.normalized, axis=1) == pytest.approx(np.ones(13), abs=ROUNDING)
    saved = drag(equilibrium(Flock.of(CONFIGURATION)).speed[0]) - 1.0
    assert -np.nansum(data.drag, axis=1) == pytest.approx(np.full(13, saved), abs=ROUNDING)


def test_birds_that_do_not_exist_contribute_nothing() -> None:
    data = contributions()
    assert list(data.neighbours[0]) == [1] * 12
    assert list(data.neighbours[3]) == [2] * 3 + [1] * 6 + [0] * 3
    assert list(data.neighbours[6]) == [2] * 6 + [0] * 6
    assert np.array_equal(np.isnan(data.drag), data.neighbours == 0)


def test_nearest_neighbours_contribute_most_and_others_ever_less() -> None:
    for part in contributions().normalized:
        assert 0.75 < part[0] < 0.85
        assert (np.diff(part[np.isfinite(part)]) < 0.0).all()


# Figure 3


def test_all_birds_save_what_their_speed_costs_beyond_their_thrust(equal) -> None:
    for (_, birds), state in equal.states.items():
        expected = np.full(birds, drag(state.speed[0]) - 1.0)
        assert state.drag_reduction[:, 0] == pytest.approx(expected, abs=ROUNDING)


def test_drags_of_neighbours_follow_the_papers_linear_profile(equal) -> None:
    pair = 2.0 * even_part(2.0 + TIP_SPACING, VORTEX_FRACTION, VORTEX_FRACTION)
    for birds in equal.sizes():
        x = equal.states["nearest", birds].position[:, 0]
        i = np.arange(2, (birds + 1) // 2 + 1)
        integral = interaction_integral(
            x[i - 1] - x[i - 2], 2.0 + TIP_SPACING, VORTEX_FRACTION, VORTEX_FRACTION
        )
        assert integral == pytest.approx(pair * (1.0 - (i - 1) / birds), rel=ROUNDING)


def test_spacings_fall_towards_the_leader(equal) -> None:
    for (_, birds), state in equal.states.items():
        spacing = np.diff(state.position[: (birds + 1) // 2, 0])
        assert (spacing > 0.0).all()
        assert (np.diff(spacing) < 0.0).all()
        # The all-to-all state is found to within the rounding of forces over its stiffness.
        assert state.position[:, 0] == pytest.approx(state.position[::-1, 0], abs=1e-9)


@pytest.mark.parametrize("coupling", ["nearest", "all"])
def test_larger_flocks_are_faster_and_save_more_but_ever_less_so(equal, coupling: str) -> None:
    sizes = equal.sizes()
    assert sizes[0] == 3
    assert sizes[-1] == 51
    for mean in (equal.speed(coupling, sizes), equal.drag_reduction(coupling, sizes)):
        assert (np.diff(mean) > 0.0).all()
        assert (np.diff(mean, n=2) < 0.0).all()


# Figure 5


def test_a_modified_flock_saves_what_each_birds_forces_ask_for(modified) -> None:
    for bird, state in modified.items():
        ratio = np.ones((13, 3))
        ratio[bird - 1] = CASES[bird]
        expected = drag(state.speed, ratio) - ratio**4
        assert state.drag_reduction == pytest.approx(expected, abs=ROUNDING)


def test_a_longer_bird_flies_further_ahead_and_saves_less(modified) -> None:
    for bird in (1, 4):
        shorter, same, longer = modified[bird].position[bird - 1]
        assert shorter < same < longer
    shorter, same, longer = modified[7].position[0]
    assert longer < same < shorter
    for bird, state in modified.items():
        shorter, same, longer = state.drag_reduction[bird - 1]
        assert longer < same < shorter
        change = np.abs(state.drag_reduction[:, [0, 2]] - state.drag_reduction[:, [1]])
        assert list(change.argmax(axis=0)) == [bird - 1] * 2


def test_the_span_ratios_shown_are_well_within_the_limits() -> None:
    for limits in exact_limits(GEESE, list(CASES), 0.5, 1.5):
        below, same, above = CASES[limits.bird]
        assert same == 1.0
        assert limits.lower is not None
        assert limits.upper is not None
        assert below - limits.lower.ratio > 0.3 * (1.0 - limits.lower.ratio)
        assert limits.upper.ratio - above > 0.3 * (limits.upper.ratio - 1.0)


# Files


def rows(content: bytes) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(content.decode())))


def test_tables_keep_every_digit(equal, modified) -> None:
    first, *_ = rows(contributions().table().csv())
    assert first["state"] == "steady homogeneous all-to-all"
    assert float(first["normalized_contribution"]) == contributions().normalized[0, 0]

    places = rows(equal.configurations().csv())
    assert len(places) == 2 * sum(SHOWN)
    means = rows(equal.means().csv())
    speeds = [float(row["speed_over_Umin"]) for row in means if row["coupling"] == "all"]
    assert speeds == list(equal.speed("all", equal.sizes()))

    table = rows(modified_table(modified).csv())
    assert len(table) == 3 * 3 * 13
    for row in table:
        bird, i = int(row["modified_bird"]), int(row["bird"]) - 1
        m = CASES[bird].index(float(row["span_ratio"]))
        assert 2.0 * float(row["x_over_2b"]) == modified[bird].position[i, m]
        assert 2.0 * float(row["y_over_2b"]) == modified[bird].lateral[i, m]
        assert float(row["drag_reduction"]) == modified[bird].drag_reduction[i, m]


def test_figures_have_the_units_of_the_tools(equal, modified) -> None:
    places, _, means = draw_steady(equal).axes
    assert places.get_ylabel() == "streamwise position $x_i$ (b)"
    assert places.get_xlabel() == "lateral position $y_i$ (b)"
    largest = next(line for line in places.lines if len(line.get_xdata()) == max(SHOWN))
    assert largest.get_xdata()[-1] == equal.states["all", max(SHOWN)].lateral[-1, 0]
    assert means.get_ylabel() == "mean drag reduction $\\eta$ (%)"
    assert max(means.lines[0].get_ydata()) == pytest.approx(17.3, abs=0.1)
    upper, *_, lower = draw_modified(modified).axes
    assert upper.get_ylabel() == "streamwise position $x_i$ (b)"
    assert upper.lines[1].get_ydata().tolist() == modified[1].position[:, 1].tolist()
    drawn = lower.lines[1].get_ydata()
    assert drawn == pytest.approx(100.0 * modified[7].drag_reduction[:, 1], rel=1e-15)
    assert lower.figure.axes[3].get_ylabel() == "drag reduction $\\eta_i$ (%)"


def test_numbers_are_written_plainly() -> None:
    table = Table(("a", "b"), [[np.float64(0.1), None], [np.bool_(True), np.int64(3)], [True, 1]])
    assert table.csv() == b"a,b\n0.1,\ntrue,3\ntrue,1\n"


def test_limits_are_written_with_their_gaps() -> None:
    kept, never = rows(limits_table([Limits(1, None, End(1.25, 2)), LOST], GEESE).csv())
    assert (kept["lower_span_ratio"], kept["gap_that_opens_below"]) == ("", "")
    assert (kept["upper_span_ratio"], kept["gap_that_opens_above"]) == ("1.25", "2")
    assert (kept["never"], never["never"]) == ("false", "true")


@pytest.mark.slow
def test_files_are_there_and_the_same_when_drawn_twice(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(files, "RESOLUTION", 50)
    before = dict(mpl.rcParams)
    contents = []
    for name in ("one", "a/second"):
        assert run_tool(tool, ["--output", str(tmp_path / name)]) == 0
        told = capsys.readouterr()
        assert told.out.splitlines() == [str(tmp_path / name / file) for file in FILES]
        assert told.err == ""
        contents.append({path.name: path.read_bytes() for path in (tmp_path / name).iterdir()})
    assert sorted(contents[0]) == sorted(FILES)
    assert all(contents[0].values())
    for file in FILES:
        assert contents[0][file] == contents[1][file], file
    assert dict(mpl.rcParams) == before


def test_an_output_that_cannot_be_written_is_one_line_and_status_2(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").touch()
    (tmp_path / "taken" / "figure_2.png").mkdir(parents=True)
    for output, named in (
        ("file", "File exists"),
        ("file/below", "Not a directory"),
        ("taken", "figure_2.png: is a directory"),
    ):
        error = error_of(tool, capsys, "--output", str(tmp_path / output))
        assert error.startswith(f"error: --output {tmp_path / output}")
        assert named in error


# Legibility


def check_legible(figure: Figure, overlap: float = 0.5) -> None:
    """Nothing written may be cut off, small, or on top of something else, by `overlap` in pt."""
    assert figure.get_figwidth() in (COLUMN, PAGE)
    found = texts(figure)
    assert len(found) > 5
    assert min(text.get_fontsize() for text in found) >= SMALL
    assert not cut_off(figure)
    assert not overlaps(figure, overlap)


def test_every_figure_can_be_read(equal, modified) -> None:
    for figure in (draw_contributions(contributions()), draw_steady(equal)):
        check_legible(figure)
    check_legible(draw_modified(modified))


LOST = Limits(2, None, None, never=True)
BESIDE_A_LONG_BIRD = FlockConfiguration(span_ratios=("4=1.0345678", "5=0.9923456", "12=0.9912345"))
MANY = FlockConfiguration(birds=60, coupling="all", span_ratios=("30=1.02",))


@pytest.mark.parametrize(
    ("configuration", "limits"),
    [
        (GEESE, None),
        (FlockConfiguration(birds=2), None),
        (FlockConfiguration(birds=3), None),
        (FlockConfiguration(birds=5, coupling="all"), None),
        (FlockConfiguration(birds=5, span_ratios=("1=0.9",)), None),
        (BESIDE_A_LONG_BIRD, None),
        (GEESE, [Limits(7, None, None)]),
        (GEESE, [Limits(2, None, End(1.2, 3)), Limits(5, End(0.7, None), None)]),
        (GEESE, [Limits(1, End(0.51, 1), End(1.49, 12)), LOST]),
        (GEESE, [Limits(2, None, None, never=True)]),
        (MANY, [Limits(i, End(0.999 - 0.003 * i, 59), End(1.03, i)) for i in range(1, 61)]),
        (MANY, [Limits(i, End(0.9 - 0.006 * i, 1), End(1.4, i)) for i in range(1, 61)]),
    ],
)
def test_limits_of_every_kind_are_drawn_legibly(
    configuration: FlockConfiguration, limits: list[Limits] | None
) -> None:
    if limits is None:
        limits = exact_limits(configuration, modified_birds(configuration), 0.5, 1.5)
    figure = draw_limits(limits, configuration, 0.5, 1.5)
    # Names of gaps side by side are digits only, without the descenders that a line has room for.
    check_legible(figure, 0.5 if len(limits) < 30 else 2.0)
    bottom, top = figure.axes[0].get_ylim()
    assert bottom <= 0.5 < 1.5 <= top
    if len(figure.axes) == 2:
        assert (bottom, top) == (0.5, 1.5)
    named = {text.get_text() for text in figure.axes[-1].texts}
    ends = [end for found in limits for end in (found.lower, found.upper) if end]
    bar = "|" if len(limits) < 30 else "–"
    assert {f"{end.gap}{bar}{end.gap + 1}" for end in ends if end.gap} <= named


@pytest.mark.parametrize(
    ("birds", "coupling"), [(5, "nearest"), (13, "nearest"), (40, "nearest"), (5, "all")]
)
def test_limits_of_thrust_are_drawn_legibly(birds: int, coupling: str) -> None:
    flock = FlockConfiguration(birds=birds, coupling=coupling, span_ratios=("2=1.005",))
    limits = exact_thrust_limits(flock, modified_birds(flock), 0.0, 2.0)
    figure = draw_limits(limits, flock, 0.0, 2.0, "thrust")
    check_legible(figure, 0.5 if len(limits) < 30 else 2.0)
    assert {axes.get_ylabel() for axes in figure.axes} == {"thrust ratio $T/T_0$"}
    # Bird 2 has a span ratio of its own, but a ratio of thrusts of 1.
    assert not [line for axes in figure.axes for line in axes.lines if line.get_marker() == "o"]


def test_an_interval_of_thrust_ends_at_no_thrust() -> None:
    limits = [Limits(1, None, End(1.2, 3), tried=((0.0, 0), (2.0, 3)))]
    assert not lines(draw_limits(limits, GEESE, 0.0, 2.0, "thrust"), "v")
    assert lines(draw_limits(limits, GEESE, 0.1, 2.0, "span"), "v") == [(1.0, 0.1)]


def lines(figure: Figure, marker: str) -> list[tuple[float, float]]:
    """Where a marker is drawn, in the first panel."""
    found = [line for line in figure.axes[0].lines if line.get_marker() == marker]
    return [(float(line.get_xdata()[0]), float(line.get_ydata()[0])) for line in found]


def test_a_limit_is_an_end_an_arrow_or_a_cross() -> None:
    limits = [Limits(1, None, End(1.2, 3)), LOST, Limits(3, End(0.8, None), None)]
    figure = draw_limits(limits, GEESE, 0.5, 1.5)
    assert lines(figure, "v") == [(1.0, 0.5)]
    assert lines(figure, "^") == [(3.0, 1.5)]
    assert lines(figure, "x") == [(2.0, 1.0)]
    assert lines(figure, "_") == [(1.0, 1.2), (3.0, 0.8)]
    explained = [text.get_text() for text in figure.legends[0].get_texts()]
    assert len(explained) == 5


def test_very_many_limits_are_drawn_without_names() -> None:
    flock = FlockConfiguration(birds=140)
    limits = [Limits(i, End(0.99, i), End(1.07, i)) for i in range(1, 71)]
    figure = draw_limits(limits, flock, 0.5, 1.5)
    check_legible(figure)
    assert [text.get_text() for text in figure.axes[-1].texts] == ["$\\lambda=1$"]
