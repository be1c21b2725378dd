# SPDX-License-Identifier: Apache-2.0
"""A report agrees with the bag, keeps every extreme, and escapes all markup."""

import base64
import hashlib
import html
import json
import os
import re
import shlex
import shutil
import subprocess
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from flock_sim.bag.topic import Topic
from flock_sim.bag.writing.writer import BagWriter
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.configuration.options import add_flock_options, flock_configuration
from flock_sim.console.arguments import Parser
from flock_sim.messages.types import Push
from flock_sim.physics.scaling import Scales
from flock_sim.recording import flight_bag, flight_writer
from flock_sim.recording.flight_writer import recording
from flock_sim.recording.machine import this_machine
from flock_sim.recording.output_directory import remove_bag
from flock_sim.recording.own_parts import LAW, OwnPart
from flock_sim.recording.run import Run
from flock_tools.commands.report import tool
from flock_tools.report import data as report_data
from flock_tools.report.data import MOST_NUMBERS, Room
from flock_tools.report.decimation import bucket_width, ends, extremes, frame_rows
from flock_tools.report.html import PAGE, SCRIPTS
from flock_tools.runs.dataset import load
from support.flights import flown_rows, record
from support.hanging import not_hanging
from support.tool_runs import error_of, json_of, text_of

HOSTILE = "</script><script>alert(1)</script><img src=x onerror=alert(2)>{{ 7 * 7 }}"
CONFIGURATION = FlockConfiguration(
    birds=5, t_max=200.0, record_every=1, span_ratios=("2=1.0,1.04,0.97",)
)


class Page(HTMLParser):
    """What a browser makes of a page: its tags, its scripts, its text."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.scripts: list[str] = []
        self.text = ""
        self._open = ""
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        self._open = tag
        if tag == "script":
            self.scripts.append("")

    def handle_endtag(self, tag: str) -> None:
        self._open = ""

    def handle_data(self, data: str) -> None:
        if self._open == "script":
            self.scripts[-1] += data
        elif self._open != "style":
            self.text += data

    @property
    def data(self) -> dict[str, Any]:
        """What the script reads."""
        value = json.loads(self.scripts[0], parse_constant=pytest.fail)
        assert isinstance(value, dict)
        return value


def unpacked(array: dict[str, Any]) -> np.ndarray:
    """Return an array with its members last again."""
    numbers = np.frombuffer(base64.b64decode(array["values"]), dtype="<f4")
    return numbers.reshape(array["shape"]).T


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("flight") / "run", CONFIGURATION)


def reported(*runs: Path, output: Path) -> Page:
    assert tool([*map(str, runs), "--output", str(output)]) == 0
    assert output.stat().st_size < 3e6
    return Page(output.read_text(encoding="utf-8"))


@given(
    values=arrays(
        np.float64,
        array_shapes(min_dims=1, max_dims=3, max_side=40),
        elements=st.floats(allow_nan=True, allow_infinity=True),
    ),
    most=st.integers(1, 12),
)
def test_every_bucket_keeps_its_extremes_in_their_order(values: np.ndarray, most: int) -> None:
    width = bucket_width(len(values), most)
    kept = extremes(values, width)
    known = np.where(np.isfinite(values), values, np.nan)
    if width == 1:
        np.testing.assert_array_equal(kept, known)
        return
    assert len(kept) == 2 * -(-len(values) // width) <= 2 * most
    for k, first in enumerate(range(0, len(values), width)):
        bucket = known[first : first + width].reshape(min(width, len(values) - first), -1)
        pair = kept[2 * k : 2 * k + 2].reshape(2, -1)
        for column, (one, other) in zip(bucket.T, pair.T):
            finite = column[np.isfinite(column)]
            if not len(finite):
                assert np.isnan([one, other]).all()
                continue
            assert {one, other} == {finite.min(), finite.max()}
            assert list(column).index(one) <= list(column).index(other)


@given(rows=st.integers(1, 5000), most=st.integers(2, 400))
def test_times_and_frames_reach_from_start_to_end(rows: int, most: int) -> None:
    times = np.arange(rows) * 0.5
    width = bucket_width(rows, most)
    drawn = ends(times, width)
    assert len(drawn) == len(extremes(times, width))
    assert (np.diff(drawn) >= 0.0).all()
    frames = frame_rows(rows, most)
    assert len(frames) <= most
    assert (np.diff(frames) > 0).all()
    for first, last in ((drawn[0], drawn[-1]), (times[frames[0]], times[frames[-1]])):
        assert (first, last) == (times[0], times[-1])


def test_the_page_holds_what_the_bag_holds(flight: Path, tmp_path: Path) -> None:
    (run,) = reported(flight, output=tmp_path / "a.html").data["runs"]
    bag = load(flight).transpose("time", "bird", "member")
    assert run["members"] == 3
    with Run(flight) as opened:
        metrics = opened.metrics()
    expected = {
        "time": bag.time,
        "speed": bag.speed,
        "spacing": bag.position.diff("bird"),
        "speed_std": bag.speed.std("bird").where(bag.time > 0.0).to_numpy()[:, np.newaxis],
        "final_spacing": metrics.spacing.T,
        "lateral": bag.lateral,
    }
    for name, values in expected.items():
        np.testing.assert_array_equal(unpacked(run[name]), np.asarray(values, dtype="<f4"), name)
    np.testing.assert_array_equal(
        unpacked(run["drag_reduction"])[-1], metrics.drag_reduction.T.astype("<f4")
    )
    rows = np.searchsorted(bag.time, unpacked(run["frame_time"]))
    position = bag.position - bag.position.sel(bird=3)
    np.testing.assert_array_equal(
        unpacked(run["frame_position"]), position.to_numpy()[rows].astype("<f4")
    )


def test_a_long_run_keeps_the_extremes_however_it_is_read(
    flight: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(report_data, "MOST_BUCKETS", 20)
    pages = []
    for part in (report_data.PART, 1):
        monkeypatch.setattr(report_data, "PART", part)
        page = reported(flight, output=tmp_path / "a.html")
        pages.append(page.data)
    assert pages[0] == pages[1]
    (run,) = pages[0]["runs"]
    speed = load(flight).speed.transpose("time", "bird", "member").to_numpy()
    kept = unpacked(run["speed"])
    assert len(kept) <= 40
    np.testing.assert_array_equal(kept.max(axis=0), speed.max(axis=0).astype("<f4"))
    np.testing.assert_array_equal(kept.min(axis=0), speed.min(axis=0).astype("<f4"))
    assert "Of the 201 recorded rows" in page.text


def test_values_at_a_time_are_those_of_the_bag_in_a_long_run(
    flight: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(report_data, "MOST_BUCKETS", 20)
    (run,) = reported(flight, output=tmp_path / "a.html").data["runs"]
    bag = load(flight).transpose("time", "bird", "member")
    at = bag.isel(time=np.searchsorted(bag.time, unpacked(run["frame_time"])))
    assert at.time[0] == 0.0
    assert at.time[-1] == 200.0
    scales = Scales.of(CONFIGURATION)
    saved = -at.interaction_drag.to_numpy() / scales.cruise_drag
    expected = {
        "speed": at.speed.to_numpy(),
        "spacing": np.diff(at.position.to_numpy(), axis=1),
        "drag_reduction": saved,
        "speed_std": at.speed.to_numpy().std(axis=1, keepdims=True),
        "mean_drag_reduction": saved.mean(axis=1, keepdims=True),
    }
    for name, values in expected.items():
        found = unpacked(run[f"frame_{name}"])
        np.testing.assert_allclose(found, values.astype("<f4"), rtol=2e-7, atol=1e-12)
    # The curve does not begin with the rounding of equal speeds.
    assert np.nanmin(unpacked(run["speed_std"])) > 1e-6


def test_theory_is_the_linear_law_for_equal_birds(tmp_path: Path) -> None:
    path = record(tmp_path / "run", FlockConfiguration(birds=7, t_max=20.0))
    (run,) = reported(path, output=tmp_path / "a.html").data["runs"]
    linear, steady = unpacked(run["linear_spacing"]), unpacked(run["steady_spacing"])
    assert np.isfinite(steady).all()
    # Both solve for a spacing to some 1e-15 b, and are written as 32-bit floats.
    np.testing.assert_allclose(steady, linear, rtol=2e-7, atol=1e-7)
    assert unpacked(run["eigen_real"]).shape == (13, 1)


def test_a_flock_whose_leader_is_nowhere_is_still_shown(tmp_path: Path) -> None:
    path = record(
        tmp_path / "run",
        FlockConfiguration(birds=5, t_max=50.0),
        lambda bird, state: (
            replace(state, position=state.position * np.nan, speed=state.speed * np.inf)
            if bird == 3 and state.step > 0
            else state
        ),
    )
    page = reported(path, output=tmp_path / "a.html")
    assert "the speed of bird 3 is not above 0" in page.text
    last = unpacked(page.data["runs"][0]["frame_position"])[-1, :, 0]
    position = load(path).position.to_numpy()[-1, :, 0]
    np.testing.assert_array_equal(last, (position - position[0]).astype("<f4"))
    assert np.isfinite(last).tolist() == [True, True, False, True, True]


def test_markup_in_what_was_recorded_is_text(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(flight_bag, "__version__", HOSTILE)
    path = tmp_path / f"run{HOSTILE}"
    path.parent.mkdir(parents=True)
    record(path, FlockConfiguration(birds=3, t_max=20.0))
    page = reported(path, output=tmp_path / "a.html")
    tags = [tag for tag, _ in page.tags]
    assert tags.count("script") == 2
    assert "img" not in tags
    assert str(path) in page.text
    assert f"Flock {HOSTILE}" in page.text
    assert page.data["runs"][0]["name"] == str(path)
    assert "<" not in page.scripts[0]


def test_the_page_has_the_digest_and_the_machines_of_a_run(
    flight: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with Run(flight) as run:
        digest = str(run.state_digest)
    (numbers,) = json_of(tool, capsys, str(flight), "--output", str(tmp_path / "b.html"))["runs"]
    assert numbers["state_digest"] == digest
    page = reported(flight, output=tmp_path / "a.html")
    assert digest in page.text
    assert this_machine().told() in page.text


def test_a_run_of_two_machines_names_both_and_markup_in_them_is_text(tmp_path: Path) -> None:
    flown = FlockConfiguration(birds=3, t_max=20.0)
    machines = [this_machine(), replace(this_machine(), processor=HOSTILE)]
    with recording(tmp_path / "run", flown, grants=False, machines=machines) as run:
        for row in flown_rows(flown):
            run.write_row(row)
    page = reported(tmp_path / "run", output=tmp_path / "a.html")
    assert f"{machines[0].told()}; then {machines[1].told()}" in page.text
    assert [tag for tag, _ in page.tags].count("script") == 2


def test_a_run_from_before_is_reported_without_digest_and_machine(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    flown = FlockConfiguration(birds=3, t_max=20.0)
    monkeypatch.setattr(flight_writer, "result_record", lambda digest: {})
    with recording(tmp_path / "run", flown, grants=False, machines=[]) as run:
        for row in flown_rows(flown):
            run.write_row(row)
    told = json_of(tool, capsys, str(tmp_path / "run"), "--output", str(tmp_path / "b.html"))
    assert told["runs"][0]["state_digest"] is None
    page = reported(tmp_path / "run", output=tmp_path / "a.html")
    assert re.search(r"recorded on\s*not recorded\s*digest of the states\s*not recorded", page.text)


def test_only_the_script_of_the_page_may_run_and_nothing_is_fetched(
    flight: Path, tmp_path: Path
) -> None:
    page = reported(flight, output=tmp_path / "a.html")
    (policy,) = [
        attributes["content"]
        for tag, attributes in page.tags
        if attributes.get("http-equiv") == "Content-Security-Policy"
    ]
    digest = base64.b64encode(hashlib.sha256(page.scripts[1].encode()).digest()).decode()
    assert policy is not None
    assert policy.startswith("default-src 'none';")
    assert f"script-src 'sha256-{digest}';" in policy
    asked = [
        attributes[key]
        for _, attributes in page.tags
        for key in ("src", "href")
        if key in attributes
    ]
    assert asked == ["data:,"]
    text = (tmp_path / "a.html").read_text(encoding="utf-8")
    for words in ("http://", "https://", "@import", "url(", "fetch(", "XMLHttpRequest"):
        assert words not in text


def test_every_picture_has_a_text_and_a_table(flight: Path, tmp_path: Path) -> None:
    page = reported(flight, output=tmp_path / "a.html")
    canvases = [attributes for tag, attributes in page.tags if tag == "canvas"]
    pictures = [picture for picture in canvases if picture.get("role") == "img"]
    ids = {attributes.get("id") for _, attributes in page.tags}
    assert len(pictures) == 9
    assert all(other["aria-hidden"] == "true" for other in canvases if other not in pictures)
    for picture in pictures:
        assert picture["aria-label"]
        assert f"{picture['id']}-table" in ids


def test_runs_are_compared_and_what_differs_is_marked(flight: Path, tmp_path: Path) -> None:
    other = record(tmp_path / "all", replace(CONFIGURATION, coupling="all", t_max=100.0))
    page = reported(flight, other, output=tmp_path / "a.html")
    assert [run["name"] for run in page.data["runs"]] == [str(flight), str(other)]
    assert "coupling (differs)" in page.text
    assert "birds (differs)" not in page.text
    text = (tmp_path / "a.html").read_text(encoding="utf-8")
    keys = re.findall(r'<th scope="row">([a-z_]+(?: \(differs\))?)</th>', text)
    differing = ["coupling (differs)", "t_max (differs)"]
    assert keys[:5] == [*differing, *differing, "birds"]  # beside the numbers, and of all keys
    for path in (flight, other):
        assert f"{path.name}, member 3" in page.text
        (file,) = path.glob("*.mcap")
        assert hashlib.sha256(file.read_bytes()).hexdigest() in page.text


def test_laws_of_one_name_and_different_sources_differ(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    flown = FlockConfiguration(birds=3, t_max=20.0)
    paths = [record(tmp_path / name, flown) for name in ("first", "second")]
    digests = {"first": "sha256:" + 32 * "1a", "second": "sha256:" + 32 * "2b"}
    parts = property(lambda run: [OwnPart(LAW, "l.py:l", digests[run.path.name])])
    monkeypatch.setattr(Run, "own_parts", parts)
    page = reported(*paths, output=tmp_path / "a.html")
    assert "own parts (differs)" in page.text
    assert "law l.py:l (1a1a1a1a1a1a)" in page.text


@pytest.mark.parametrize(
    "flown",
    [
        FlockConfiguration(t_max=20.0),
        FlockConfiguration(birds=5, coupling="all", dt=0.5, t_max=20.0, record_every=4),
        FlockConfiguration(
            birds=3,
            t_max=20.0,
            body_mass=4.0,
            span_ratios=("2=1.0,1.04",),
            perturbations=("2@4=0.1,-0.01",),
            links=("hold:interval=2", "1->2=linear:interval=4"),
        ),
    ],
)
def test_what_the_page_gives_for_the_command_line_flies_the_same(
    flown: FlockConfiguration, tmp_path: Path
) -> None:
    record(tmp_path / "run", flown)
    page = reported(tmp_path / "run", output=tmp_path / "a.html")
    given, _, rest = page.text.partition("./flock fly")[2].partition(" (flies the same flock")
    assert rest
    file = tmp_path / "flock.yaml"
    text = (tmp_path / "a.html").read_text(encoding="utf-8")
    file.write_text(
        html.unescape(text.partition("<pre")[2].partition(">")[2].partition("</pre")[0])
    )
    words = shlex.split(given.replace("flock.yaml", str(file)))
    parser = Parser("fly", "", "")
    add_flock_options(parser)
    assert flock_configuration(parser.parse_args(words)) == flown


def test_the_command_does_not_claim_to_push_as_in_flight(tmp_path: Path) -> None:
    flown = FlockConfiguration(birds=2, t_max=20.0)
    with recording(tmp_path / "run", flown, grants=True) as run:
        run.write_perturbation(Push(0, 10, 0.1, 0.0, number=1, bird=2, member=1))
        for row in flown_rows(flown):
            run.write_row(row)
    page = reported(tmp_path / "run", output=tmp_path / "a.html")
    assert "(flies the same flock without the perturbations in flight;" in page.text
    assert "reference --repeat" in page.text


def test_the_report_lies_beside_the_bag_which_can_be_flown_over(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = record(tmp_path / "run", FlockConfiguration(birds=1, t_max=20.0))
    assert text_of(tool, capsys, str(path)) == f"{path / 'report.html'}\n"
    first = (path / "report.html").read_bytes()
    told = json_of(tool, capsys, str(path))
    assert told["output"] == str(path / "report.html")
    assert told["bytes"] == len(first)
    assert (path / "report.html").read_bytes() == first
    with Run(path) as run:
        assert told["runs"][0]["mean_speed"] == run.metrics().mean_speed.tolist()
    remove_bag(path)
    assert not path.exists()


@given(flocks=st.lists(st.tuples(st.integers(1, 60), st.integers(1, 3000)), min_size=1, max_size=6))
def test_whatever_is_reported_fits_in_one_file(flocks: list[tuple[int, int]]) -> None:
    flights = [FlockConfiguration(birds=birds) for birds, _ in flocks]
    for flown, (birds, members) in zip(flights, flocks):
        flown.__dict__["span_ratio"] = np.ones((birds, members))
    room = Room.of(flights)
    assert room.buckets >= report_data.FEWEST_BUCKETS
    numbers = [
        (6 + 2 * report_data.FRAMES) * flown.birds * members * room.buckets
        for flown, members in zip(flights, room.members)
    ]
    assert sum(numbers) <= MOST_NUMBERS
    for (_, members), shown in zip(flocks, room.members):
        assert 1 <= shown <= members


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        ([], "RUN"),
        (["nowhere"], "nowhere"),
        (
            ["RUN", "OTHER"],
            "has 2 birds and RUN has 5: runs in one report must have the same number",
        ),
        (["EMPTY"], "no recorded step is complete"),
        (["others"], "not a bag of Flock's"),
        (["sqlite"], "or use ros2 bag convert"),
        (["RUN", "--output", "no/such/a.html"], "no/such is no directory"),
        (["RUN", "--output", "bag.mcap"], "must end in one of .html, .htm"),
        (["RUN", "--output", "made.html"], "is a directory"),
        (["RUN", "--output", "/dev/full/a.html"], "/dev/full is no directory"),
    ],
)
def test_what_cannot_be_reported_is_said_in_one_line(
    arguments: list[str],
    named: str,
    flight: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("made.html").mkdir()
    Path("sqlite").mkdir()
    Path("sqlite/sqlite_0.db3").touch()
    with BagWriter(Path("others"), [Topic("/words", "std_msgs/msg/String")], {}) as bag:
        bag.write("/words", 0, bytes(8))
    other = record(tmp_path / "other", FlockConfiguration(birds=2, t_max=20.0))
    empty = record(tmp_path / "empty", FlockConfiguration(birds=2, t_max=20.0), states=[])
    places = {"RUN": str(flight), "OTHER": str(other), "EMPTY": str(empty)}
    line = error_of(tool, capsys, *(places.get(word, word) for word in arguments))
    assert named.replace("RUN has", f"{flight} has") in line
    assert not (flight / "report.html").exists()


@pytest.mark.parametrize("name", SCRIPTS)
def test_the_scripts_are_javascript(name: str) -> None:
    node = shutil.which("node")
    if node is None:
        pytest.skip("there is no node on this machine")
    done = subprocess.run([node, "--check", PAGE / name], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_a_pipe_beside_the_recording_is_not_waited_for(flight: Path, tmp_path: Path) -> None:
    bag = tmp_path / "run"
    shutil.copytree(flight, bag)
    os.mkfifo(bag / "pipe.mcap")
    with not_hanging():
        page = reported(bag, output=tmp_path / "report.html")
    assert "run_0.mcap" in page.text
    assert "pipe.mcap" not in page.text
