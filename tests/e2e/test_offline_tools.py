# SPDX-License-Identifier: Apache-2.0
"""Every offline tool reads every flight, and its numbers are those of the bag.

FLOCK_VARIED_FLIGHTS=N reads N flights instead of a few.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import pytest
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure

from flock_sim.bag.reading.reader import BagReader
from flock_sim.commands import reference
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.configuration.parameter_file import text as parameter_text
from flock_sim.console.arguments import run_tool
from flock_sim.messages.state import ARRAYS, VALUES
from flock_sim.recording.run import Run
from flock_tools.commands import compare, metrics, picture, repair, report, view
from flock_tools.figures import output
from flock_tools.figures.bird_outline import OUTLINE
from flock_tools.runs.dataset import load
from flock_tools.scene.picture import scene_of
from support.bag_arrays import BagArrays
from support.varied_flights import KINDS, cut, varied_flight
from unit.commands.test_report import Page, unpacked

COUNT = int(os.environ.get("FLOCK_VARIED_FLIGHTS", "6"))


def close(found: Any, expected: Any, digits: int | None = None, **limits: float) -> None:
    """Compare numbers; None is nan, or infinite. `digits` are those after the point in a text."""
    values = np.array(found, dtype=float)
    wanted = np.array(expected, dtype=float)
    wanted = wanted if digits is not None else np.where(np.isfinite(wanted), wanted, np.nan)
    values = values if digits is not None else np.where(np.isfinite(values), values, np.nan)
    limits = {"rtol": 1e-11, "atol": 1e-12, **limits}
    if digits is not None:
        limits["atol"] = 0.5000001 * 10.0**-digits
    np.testing.assert_allclose(values, wanted, **limits)


def as_float32(values: np.ndarray) -> np.ndarray:
    return np.where(np.isfinite(values), values, np.nan).astype("<f4")


def flown_by_reference(directory: Path, name: str, flight: FlockConfiguration) -> Path:
    file = directory / f"{name}.yaml"
    file.write_text(parameter_text(flight.parameters()), encoding="utf-8")
    assert run_tool(reference.tool, ["--config", str(file), "--output", str(directory / name)]) == 0
    return directory / name


Say = Callable[..., str]


@pytest.fixture
def say(capsys: pytest.CaptureFixture[str]) -> Say:
    """Run a tool, which must end well, and return what it prints."""

    def run(tool: Any, *arguments: object, status: int = 0) -> str:
        capsys.readouterr()
        assert run_tool(tool.tool, [str(each) for each in arguments]) == status
        return capsys.readouterr().out

    return run


@pytest.fixture
def figures(monkeypatch: pytest.MonkeyPatch) -> list[Figure]:
    """The figures that tools have drawn."""
    drawn: list[Figure] = []
    monkeypatch.setattr(output, "RESOLUTION", 30)

    def write(figure: Figure, *arguments: Any) -> None:
        drawn.append(figure)
        output.write_picture(figure, *arguments)

    for module in (picture, view):
        monkeypatch.setattr(module, "write_picture", write)
    return drawn


def check_metrics(say: Say, bag: BagArrays, row: int, at: tuple[object, ...]) -> None:
    told = json.loads(say(metrics, bag.path, *at, "--json"))
    head = bag.leader - 1
    close(told["t_final"], bag.time[row])
    close(told["mean_speed"], bag.speed[row].mean(axis=0))
    close(told["speed_std"], bag.spread[row])
    close(told["spacing"], bag.spacing[row].T)
    close(told["position"], bag.relative[row].T)
    close(told["lateral"], bag.lateral.T)
    close(told["drag_reduction"], bag.saved[row].T)
    close(told["mean_drag_reduction"], bag.saved[row].mean(axis=0))
    for m in range(bag.flown.members):
        if means := over_time(bag, row, m):
            close(told["time_mean_speed"][m], means[0])
            close(told["time_mean_drag_reduction"][m], means[1] / 100.0)
    finite = np.isfinite(bag.position[row]).all(axis=0) & np.isfinite(bag.speed[row]).all(axis=0)
    assert told["stable"] == ((bag.spread[row] < 1e-4) & finite).tolist()
    left = bag.spacing[row][:head]
    falls = (np.diff(left, axis=0) < 0.0).all(axis=0) & np.isfinite(left).all(axis=0)
    assert told["hierarchical"] == falls.tolist()

    text = say(metrics, bag.path, *at)
    members = re.split(r"\nmember \d+\n", text)[-min(bag.flown.members, 12) :]
    for m, lines in enumerate(members):
        numbers = numbers_in(lines)
        close(numbers["mean speed U*"], bag.speed[row, :, m].mean(keepdims=True), 9)
        close(numbers["spread sigma_U"], bag.spread[row, m : m + 1], 13, rtol=6e-4)
        close(numbers["mean drag reduction"], [100.0 * bag.saved[row, :, m].mean()], 2)
        if bag.flown.birds > 1:
            gaps = next(v for k, v in numbers.items() if k.startswith("spacing"))
            close(gaps, bag.spacing[row, :head, m], 4)
            reductions = next(v for k, v in numbers.items() if k.startswith("drag saved"))
            close(reductions, 100.0 * bag.saved[row, : len(reductions), m], 1)
        if right := numbers.get("spacing, right wing"):
            close(right, -bag.spacing[row, head:, m][::-1], 4)


def over_time(bag: BagArrays, row: int, m: int) -> list[float]:
    """Mean speed and saved drag in % over the last tenth of the time up to a row, of all birds.

    Empty if no member of the flight has such a mean.
    """
    every, end = bag.flown.record_every, bag.step[row]
    records = max(1, round(0.1 * end / every))
    rows = np.flatnonzero((bag.step > end - every * records) & (bag.step <= end))
    steps = np.where(bag.step[rows] > 0, every, 1)[:, np.newaxis, np.newaxis]
    with np.errstate(all="ignore"):
        speed = (steps * bag.mean_speed[rows]).sum(axis=0) / steps.sum()
        drag = (steps * bag.mean_interaction_drag[rows]).sum(axis=0) / steps.sum()
        saved = -100.0 * drag / bag.cruise_drag
        means = speed.mean(axis=0)
        known = bool(np.isfinite(means).any())
        return [float(means[m]), float(saved[:, m].mean())] if known else []


def numbers_in(lines: str) -> dict[str, list[float]]:
    """Return the numbers of each row of a summary, which may have several lines."""
    found: dict[str, list[float]] = {}
    name = ""
    for line in lines.splitlines():
        name = line[2:22].strip() or name
        for word in line[23:].split():
            if not re.fullmatch(r"-?(\d.*|nan|inf)", word):
                break
            found.setdefault(name, []).append(float(word))
    return found


def check_picture(say: Say, figures: list[Figure], bag: BagArrays, row: int, member: int) -> None:
    time = bag.flown.time(int(bag.step[row]))
    say(picture, bag.path, "--at", repr(time), "--member", member)
    figure, m = figures[-1], member - 1
    formation = figure.axes[0]
    low, high = formation.get_ylim()
    along, across = bag.relative[row, :, m], bag.lateral[:, m]
    here = (along >= low) & (along <= high)
    (_, drawn) = (c for c in formation.collections if isinstance(c, PolyCollection))
    ratio = bag.flown.span_ratio[:, m]
    places = [path.vertices[: len(OUTLINE)] for path in drawn.get_paths()]
    for i, wing in zip(np.flatnonzero(here), places, strict=True):
        close(wing - ratio[i] * OUTLINE, np.tile([across[i], along[i]], (len(OUTLINE), 1)))
    texts = {text.get_text().replace("−", "-") for text in formation.texts}
    for i in np.flatnonzero(np.isfinite(along) & ~here):
        far = f"{along[i]:.0f}" if abs(along[i]) < 1e6 else f"{along[i]:.3g}"
        assert f"{i + 1} at {far} b" in texts
    title = figure.get_suptitle()
    close(re.findall(r"mean speed (\S+)", title), [bag.speed[row, :, m].mean()], 4)
    shown = [100.0 * bag.saved[row, :, m].mean(), *over_time(bag, row, m)[1:]]
    close(re.findall(r"drag reduction (\S+)", title), shown, 1)
    assert f"t = {time:g}:" in title
    check_curves(figure, bag, m)


def check_curves(figure: Figure, bag: BagArrays, m: int) -> None:
    head = bag.leader - 1
    for axes in figure.axes:
        curves = [line for line in axes.lines if len(line.get_xdata()) > 2]
        if "time" not in axes.get_xlabel() or not curves:
            continue
        rows = np.searchsorted(bag.time, curves[0].get_xdata())
        close(bag.time[rows], curves[0].get_xdata())
        if "spread" in axes.get_ylabel():
            shown = np.array(curves[0].get_ydata())
            drawn = np.isfinite(shown)
            close(shown[drawn], bag.spread[rows, m][drawn])
        elif "spacing" in axes.get_ylabel():
            for k, line in enumerate(curves):
                close(line.get_ydata(), bag.spacing[rows, k, m] * (1.0 if k < head else -1.0))
        else:
            close(np.ravel(curves[0].get_ydata()), bag.speed[rows, 0, m])


def check_view(say: Say, figures: list[Figure], bag: BagArrays, member: int) -> None:
    m, metre = member - 1, 0.5 * bag.flown.wing_span
    scene = bag.path.with_suffix(".scene.png")
    say(view, "--picture", scene, bag.path, "--member", member)
    texts = [text.get_text() for axes in figures[-1].axes for text in axes.texts]
    texts += [text.get_text() for text in figures[-1].texts]
    title = next(text for text in texts if "mean drag reduction" in text)
    close(re.findall(r"reduction (\S+)", title), [100.0 * bag.saved[-1, :, m].mean()], 1)
    labels = {int(text.split("\n")[0]): text for text in texts if re.match(r"\d+\n", text)}
    for bird, label in labels.items():
        assert label == f"{bird}\n{100.0 * bag.saved[-1, bird - 1, m]:.1f} %"
    position, circulation = bag.position[-1, :, m], bag.circulation[-1, :, m]
    finite = np.isfinite(position) & np.isfinite(circulation)
    if not finite.any():
        assert not labels
        return
    middle = np.sort(position[finite])[finite.sum() // 2]
    along = position - (position[bag.leader - 1] if finite[bag.leader - 1] else middle)
    assert sorted(labels) == (np.flatnonzero(finite & (np.abs(along) <= 1e9)) + 1).tolist()
    with Run(bag.path) as run:
        shapes = scene_of(run, None, m).shapes
    for shape in shapes:
        if shape.group == "birds":
            i = shape.number - 1
            close(shape.origin, [metre * along[i], -metre * bag.lateral[i, m], 0.0])


def check_report(say: Say, bag: BagArrays) -> None:
    page_file = bag.path.with_suffix(".html")
    (told,) = json.loads(say(report, bag.path, "--output", page_file, "--json"))["runs"]
    close(told["mean_speed"], bag.speed[-1].mean(axis=0))
    close(told["speed_std"], bag.spread[-1])
    close(told["mean_drag_reduction"], bag.saved[-1].mean(axis=0))
    assert told["rows"] == len(bag.step)
    (run,) = Page(page_file.read_text(encoding="utf-8")).data["runs"]
    shown = slice(run["members"])
    frames = np.searchsorted(as_float32(bag.time), unpacked(run["frame_time"]))
    assert (frames[0], frames[-1]) == (0, len(bag.step) - 1)
    series = {
        "speed": bag.speed,
        "spacing": bag.spacing,
        "drag_reduction": bag.saved,
        "speed_std": bag.spread[:, np.newaxis],
        "mean_drag_reduction": bag.saved.mean(axis=1, keepdims=True),
    }
    for name, values in series.items():
        values = values[..., shown].copy()
        close(unpacked(run[f"frame_{name}"]), as_float32(values[frames]), rtol=3e-7)
        curve = unpacked(run[name])
        if name == "speed_std":
            values[0] = np.where(values[0] < 1e-12, np.nan, values[0])
        values = np.where(np.isfinite(values), values, np.nan)
        for most in (np.fmax, np.fmin):
            kept, of_bag = (most.reduce(one, axis=0) for one in (curve, values))
            np.testing.assert_allclose(kept, of_bag.astype("<f4"), rtol=3e-7, atol=1e-12)
    first = np.isfinite(bag.position[frames]).argmax(axis=1)[:, np.newaxis]
    led = bag.position[frames][:, bag.leader - 1][:, np.newaxis]
    origin = np.where(np.isfinite(led), led, np.take_along_axis(bag.position[frames], first, 1))
    along = as_float32((bag.position[frames] - origin)[..., shown])
    close(unpacked(run["frame_position"]), along, rtol=3e-7)
    close(unpacked(run["final_spacing"]), as_float32(bag.spacing[-1][:, shown]), rtol=3e-7)


def check_compare(say: Say, bag: BagArrays, other: BagArrays) -> None:
    itself = json.loads(say(compare, bag.path, bag.path, "--json"))
    assert itself["equal"]
    assert set(itself["max_difference"].values()) == {0.0}
    told = json.loads(say(compare, bag.path, other.path, "--json", status=1))
    one, two = (
        {(bird, step * each.flown.dt): state for (bird, step), state in each.states.items()}
        for each in (bag, other)
    )
    both = one.keys() & two.keys()
    assert told["messages"] == len(both)
    assert told["missing_messages"] == [len(two) - len(both), len(one) - len(both)]
    comparable = bag.flown.members == other.flown.members and len(both) > 0
    for name in VALUES:
        if not comparable:
            assert told["max_difference"][name] is None
            continue
        first, second = (
            np.array([getattr(each[key], name) for key in sorted(both)]) for each in (one, two)
        )
        same = (first == second) | (np.isnan(first) & np.isnan(second))
        gap = np.where(same, 0.0, np.abs(first - second))
        close(told["max_difference"][name], gap.max() if np.isfinite(gap).all() else np.nan)


def check_repair(
    say: Say, bag: BagArrays, recorded: list[tuple[str, int, bytes]], whole: bool
) -> None:
    told = json.loads(say(repair, bag.path, "--json"))
    if whole:
        assert told["output"] is None
        assert told["messages"] == len(recorded)
        return
    with BagReader(told["output"]) as repaired, BagReader(bag.path) as torn:
        kept, read = list(repaired.messages()), list(torn.messages())
    assert kept == recorded[: told["messages"]]
    assert read == recorded[: len(read)]
    assert len(read) <= len(kept)


def check_dataset(bag: BagArrays) -> None:
    found = load(bag.path).transpose("time", "bird", "member")
    close(found.time, bag.time)
    for name in ARRAYS:
        np.testing.assert_array_equal(found[name].to_numpy(), getattr(bag, name))
    close(found.lateral, bag.lateral)


@pytest.mark.parametrize("seed", range(COUNT))
def test_every_number_of_every_tool_is_that_of_the_bag(
    tmp_path: Path, say: Say, figures: list[Figure], seed: int
) -> None:
    random = Random(seed)
    flight = varied_flight(random, KINDS[seed % len(KINDS)])
    path = flown_by_reference(tmp_path, "flight", flight)
    with BagReader(path) as reader:
        recorded = list(reader.messages())
    if partial := random.random() < 0.3:
        cut(random, path)
    bag = BagArrays.read(path, flight)
    if not len(bag.step):
        assert partial
        for tool in (metrics, picture, report):
            assert run_tool(tool.tool, [str(path)]) == 2
        assert run_tool(repair.tool, [str(path)]) in (0, 2)
        return
    with np.errstate(all="ignore"):
        check_repair(say, bag, recorded, not partial)
        check_dataset(bag)
        row = random.randrange(len(bag.step))
        member = random.randint(1, flight.members)
        check_metrics(say, bag, -1, ())
        check_metrics(say, bag, row, ("--at", repr(flight.time(int(bag.step[row])))))
        check_picture(say, figures, bag, row, member)
        check_view(say, figures, bag, member)
        check_report(say, bag)
        changed = random.choice([{"cruise_speed": 18.6}, {"dt": flight.dt / 2.0}, {"birds": 9}])
        other = varied_flight(random, "unequal") if "birds" in changed else None
        other = other or FlockConfiguration.from_parameters({**flight.parameters(), **changed})
        check_compare(say, bag, BagArrays.read(flown_by_reference(tmp_path, "other", other), other))
