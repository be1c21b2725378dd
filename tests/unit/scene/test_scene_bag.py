# SPDX-License-Identifier: Apache-2.0
"""The scene of a recorded flight is a rosbag2 bag that other readers read."""

from __future__ import annotations

import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader

from flock_sim.bag.definitions import copied_definition
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.console.arguments import run_tool
from flock_sim.messages.types import State
from flock_sim.recording.run import Run
from flock_tools.commands.view import tool
from flock_tools.scene import messages, scene_bag
from flock_tools.scene.frame import TOPICS, Frame
from flock_tools.scene.picture import scene_of
from flock_tools.scene.scene_bag import MOST_PICTURES, Pictures
from support.flights import record
from support.python_process import python

THREE = FlockConfiguration(birds=3, t_max=125.0, record_every=5, span_ratios=("1=0.9,1.0",))
"""25 rows after that of the start, and two members."""

CLOCK = "/clock"


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("flight") / "run", THREE)


def view(*arguments: object) -> int:
    return run_tool(tool, [str(argument) for argument in arguments])


def content(directory: Path) -> dict[str, bytes]:
    return {entry.name: entry.read_bytes() for entry in directory.iterdir()}


def test_rosbags_reads_the_scene_of_each_recorded_row(flight: Path, tmp_path: Path) -> None:
    output = tmp_path / "scene"
    assert view(flight, "--output", output, "--member", 2) == 0
    with Reader(output) as bag:
        assert {c.topic: c.msgtype for c in bag.connections} == {
            CLOCK: "rosgraph_msgs/msg/Clock",
            **{name: topic.type for name, topic in TOPICS.items()},
        }
        assert all(connection.msgcount == 26 for connection in bag.connections)
    with AnyReader([output]) as bag, Run(flight) as run:
        for connection, time, data in bag.messages():
            message = bag.deserialize(data, connection.msgtype)
            if connection.topic == CLOCK:
                stamp = message.clock
                row = round((time / 1e9) / (5 * THREE.second))
                shown = scene_of(run, 5.0 * row, 1)
            elif connection.topic == "/flock/view/markers":
                stamp = message.markers[-1].header.stamp
                birds = [m for m in message.markers if m.ns == "birds"]
                places = [(m.pose.position.x, m.pose.position.y) for m in birds]
                expected = [s.origin[:2] for s in shown.shapes if s.group == "birds"]
                assert places == pytest.approx(np.array(expected), abs=1e-9)
            elif connection.topic.startswith("/flock/view/upwash"):
                stamp = message.header.stamp
                assert message.header.frame_id == "flock"
                assert len(message.data) == message.height * message.step
            else:
                told = message.transforms[0] if connection.topic == "/tf" else message
                stamp = told.header.stamp
                assert (told.header.frame_id, told.child_frame_id) == ("world", "flock")
                x = shown.snapshot.origin * shown.snapshot.metre
                assert told.transform.translation.x == pytest.approx(x)
            assert stamp.sec * 1_000_000_000 + stamp.nanosec == time


def test_odometry_of_each_bird_is_added(flight: Path, tmp_path: Path) -> None:
    assert view(flight, "--output", tmp_path / "scene", "--member", 2, "--odometry") == 0
    with AnyReader([tmp_path / "scene"]) as bag, Run(flight) as run:
        rows = list(run.snapshots())
        lateral = run.metrics().lateral[1]  # of member 2
        for bird in (1, 2, 3):
            wanted = [c for c in bag.connections if c.topic == f"/flock/bird_{bird:02d}/odometry"]
            told = [
                (time, bag.deserialize(data, "nav_msgs/msg/Odometry"))
                for _, time, data in bag.messages(wanted)
            ]
            assert len(told) == len(rows)
            for (time, message), row in zip(told, rows, strict=True):
                assert time == THREE.stamp(row.step)
                assert message.header.frame_id == "world"
                assert message.child_frame_id == f"bird_{bird:02d}"
                place, speed = message.pose.pose.position, message.twist.twist.linear
                assert place.x == pytest.approx(0.75 * row.position[bird - 1, 1])  # b = 0.75 m
                assert place.y == pytest.approx(-0.75 * lateral[bird - 1])
                assert speed.x == pytest.approx(18.0 * row.speed[bird - 1, 1])  # U_min = 18 m/s
        tf = [c for c in bag.connections if c.topic == "/tf"]
        _, _, data = next(bag.messages(tf))
        frames = [each.child_frame_id for each in bag.deserialize(data, tf[0].msgtype).transforms]
        assert frames == ["flock", "bird_01", "bird_02", "bird_03"]


def test_mcap_reads_it_with_full_definitions(flight: Path, tmp_path: Path) -> None:
    assert view(flight, "--output", tmp_path / "scene") == 0
    with (tmp_path / "scene" / "scene_0.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert reader.get_header().profile == "ros2"
        summary = reader.get_summary()
        assert summary is not None
        for schema in summary.schemas.values():
            assert schema.encoding == "ros2msg"
            assert schema.data.decode() == copied_definition(schema.name).text
        assert {channel.message_encoding for channel in summary.channels.values()} == {"cdr"}
        times = [message.log_time for _, _, message in reader.iter_messages()]
        assert times == sorted(times)


def test_a_later_picture_has_a_trail_and_only_the_first_removes_markers(
    flight: Path, tmp_path: Path
) -> None:
    assert view(flight, "--output", tmp_path / "scene") == 0
    with AnyReader([tmp_path / "scene"]) as bag:
        wanted = [c for c in bag.connections if c.topic == "/flock/view/markers"]
        arrays = [bag.deserialize(data, c.msgtype) for c, _, data in bag.messages(wanted)]
    first, *others = [[marker.action for marker in array.markers] for array in arrays]
    assert first[0] == messages.DELETE_ALL
    assert all(messages.DELETE_ALL not in actions for actions in others)
    trails = [[m for m in array.markers if m.ns == "trails"] for array in arrays]
    assert [len(shown[0].points) if shown else 1 for shown in trails] == list(range(1, 27))


def test_the_same_flight_gives_the_same_bytes(flight: Path, tmp_path: Path) -> None:
    for place in ("one", "other"):
        (tmp_path / place).mkdir()
        assert view(flight, "--output", tmp_path / place / "scene") == 0
    assert content(tmp_path / "one" / "scene") == content(tmp_path / "other" / "scene")


def test_an_existing_bag_is_replaced_only_with_force(
    flight: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "scene"
    assert view(flight, "--output", output) == 0
    before = content(output)
    assert view(flight, "--output", output, "--member", 2) == 2
    assert "exists: add --force" in capsys.readouterr().err
    assert content(output) == before
    assert view(flight, "--output", output, "--member", 2, "--force") == 0
    assert content(output).keys() == before.keys()
    assert content(output) != before
    assert [entry.name for entry in tmp_path.iterdir()] == ["scene"]


@pytest.mark.parametrize("force", [False, True])
def test_nothing_is_left_of_a_scene_that_failed(
    flight: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, force: bool
) -> None:
    output = tmp_path / "scene"
    before: dict[str, bytes] = {}
    if force:
        assert view(flight, "--output", output) == 0
        before = content(output)
    drawn = itertools.count()

    def fail(self: Frame) -> bytes:
        if next(drawn) == 5:
            raise KeyboardInterrupt
        return b""

    monkeypatch.setattr(Frame, "upwash", property(fail))
    assert view(flight, "--output", output, *["--force"] * force) == 130
    assert [entry.name for entry in tmp_path.iterdir()] == ["scene"] * force
    assert not force or content(output) == before


def test_a_full_disk_is_one_line(
    flight: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def full(self: object, block: bytes) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("flock_sim.bag.writing.storage.AppendFile.append", full)
    assert view(flight, "--output", tmp_path / "scene") == 1
    error = capsys.readouterr().err
    assert error == f"error: --output {tmp_path}/scene: can't be written: No space left on device\n"
    assert list(tmp_path.iterdir()) == []


def test_a_flight_does_not_become_its_own_scene(
    flight: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = content(flight)
    (file,) = flight.glob("*.mcap")
    for named in (flight, file):
        assert view(named, "--output", flight, "--force") == 2
        assert "is the flight itself" in capsys.readouterr().err
        assert content(flight) == before


@pytest.mark.parametrize(
    ("record_every", "steps", "rate", "shown", "last"),
    [
        (1, 100, None, 101, 100),  # no more than were recorded
        (10, 10_000 * 10, None, 1 + 10_000 // 34 + 1, 100_000),
        (10, 1_000, 1e-9, 2, 1_000),
        (10, 1_000, 60.0, 101, 1_000),
        (10, 1_000, 0.5, 1 + 1_000 // 50, 1_000),  # 2 s are 48 steps: five rows
        (10, 5, None, 1, 0),
        (7, 100, 0.5, 3, 98),  # 48 steps are seven rows of 7 steps: 0, 49, 98
    ],
)
def test_pictures_are_recorded_rows_at_equal_distances(
    record_every: int, steps: int, rate: float | None, shown: int, last: int
) -> None:
    flown = FlockConfiguration(birds=3, t_max=float(steps), record_every=record_every)
    pictures = Pictures.of(flown, steps - steps % record_every, rate)
    drawn = list(dict.fromkeys([*pictures.steps, pictures.last]))
    assert len(pictures) == len(drawn) == shown
    assert drawn[-1] == last
    assert all(step % record_every == 0 for step in drawn)
    assert len(set(np.diff(drawn[:-1]))) <= 1
    assert rate is not None or len(pictures) <= MOST_PICTURES + 2


def test_a_bag_that_was_cut_short_is_shown_to_its_last_row(
    flight: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cut = tmp_path / "cut"
    cut.mkdir()
    (recorded,) = flight.glob("*.mcap")
    (cut / "cut_0.mcap").write_bytes(recorded.read_bytes()[:-100])
    assert view(cut, "--output", tmp_path / "scene") == 0
    assert "its intact part is shown" in capsys.readouterr().err
    with Reader(tmp_path / "scene") as bag:
        assert bag.message_count == 26 * (1 + len(TOPICS))


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_a_diverged_flock_is_shown_and_its_markers_are_removed(tmp_path: Path) -> None:
    def diverged(bird: int, state: State) -> State:
        return replace(state, position=state.position * np.nan) if state.step > 10 else state

    flown = FlockConfiguration(birds=3, t_max=25.0, record_every=5)
    path = record(tmp_path / "run", flown, diverged)
    assert view(path, "--output", tmp_path / "scene", "--odometry") == 0
    with AnyReader([tmp_path / "scene"]) as bag:
        wanted = [c for c in bag.connections if c.topic == "/flock/view/markers"]
        arrays = [bag.deserialize(data, c.msgtype) for c, _, data in bag.messages(wanted)]
        odometry = [c for c in bag.connections if c.topic == "/flock/bird_01/odometry"]
        assert [time for _, time, _ in bag.messages(odometry)] == [
            flown.stamp(step) for step in (0, 5, 10)
        ]
    removes = [[marker.action for marker in array.markers[:1]] == [3] for array in arrays]
    assert removes == [True, False, False, True, False, False]


def test_a_scene_needs_no_ros(flight: Path, tmp_path: Path) -> None:
    script = """
import sys
for name in ("rclpy", "ament_index_python", "visualization_msgs", "flock_interfaces"):
    sys.modules[name] = None
from flock_tools.commands.view import tool
tool(sys.argv[1:])
"""
    assert view(flight, "--output", tmp_path / "with" / "scene") == 0
    python(script, str(flight), "--output", str(tmp_path / "without" / "scene"))
    assert content(tmp_path / "with" / "scene") == content(tmp_path / "without" / "scene")


def test_the_note_says_how_many_pictures_and_how_large(
    flight: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(scene_bag, "MOST_PICTURES", 10)
    output = tmp_path / "scene"
    assert view(flight, "--output", output) == 0
    out, err = capsys.readouterr()
    assert out == f"{output}\n"
    size = sum(len(data) for data in content(output).values()) / 1e6
    assert err.startswith("10 pictures of member 1, ")
    assert f"{size:.1f} MB" in err
