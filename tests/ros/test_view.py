# SPDX-License-Identifier: Apache-2.0
"""The topics that `view` publishes, to ROS 2 and to Foxglove, agree with the bag."""

from __future__ import annotations

import json
import re
import socket
import struct
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import yaml
from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import Odometry
from rclpy.serialization import deserialize_message
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from sensor_msgs.msg import Image
from visualization_msgs.msg import MarkerArray
from websockets.sync.client import ClientConnection, connect

from flock_sim.bag.reading.reader import BagReader
from flock_sim.errors import FlockError
from flock_sim.recording.run import Run
from flock_tools.scene import messages, viewer
from flock_tools.scene.foxglove_server import FoxgloveServer
from flock_tools.scene.messages import FRAME
from flock_tools.scene.picture import scene_of
from support.bags import last_step
from support.terminal import Job, Terminal
from support.visitor import Visitor

FLOCK = ("--birds", 3, "--t-max", 300, "--span-ratio", "1=0.95,1.0")
SUBPROTOCOL = "foxglove.sdk.v1"
DEADLINE = 60.0
SHARE = Path(__file__).parents[2] / "src/flock_tools/view"


def recorded(terminal: Terminal, bag: str, seconds: int, nanoseconds: int, member: int):
    """Return the scene of the bag at a stamp."""
    with Run(terminal.directory / bag) as run:
        time = (seconds + 1e-9 * nanoseconds) / run.configuration.second
        every = run.configuration.record_every * run.configuration.dt
        return scene_of(run, every * round(time / every), member - 1)


def recorded_to(bag: Path) -> int:
    """Return the simulated time, in ns, up to which a flight is on disk; -1 for none."""
    step = last_step(bag)
    if step < 0:
        return -1
    with Run(bag) as run:
        return run.configuration.stamp(step)


def check_markers(terminal: Terminal, bag: str, array, member: int) -> None:
    """Hold birds and labels against the bag, at the stamp that they have."""
    stamp = array.markers[0].header.stamp
    expected = recorded(terminal, bag, stamp.sec, stamp.nanosec, member)
    heard = {(marker.ns, marker.id): marker for marker in array.markers}
    for shape in expected.shapes:
        if shape.group not in ("birds", "labels"):
            continue
        marker = heard[shape.group, shape.number]
        place = marker.pose.position
        assert (place.x, place.y, place.z) == pytest.approx(shape.origin, abs=1e-9)
        assert marker.text == shape.text
        points = np.array([(p.x, p.y, p.z) for p in marker.points]).reshape(-1, 3)
        assert points == pytest.approx(shape.points, abs=1e-9)


def test_a_played_flock_is_shown_as_it_was_recorded(terminal: Terminal, visitor: Visitor) -> None:
    terminal.well("reference", *FLOCK, "--output", "bag")
    player = terminal.start("play", "bag", "--rate", 2, "--loop")
    job = terminal.start("view", "--member", 2, "--rate", 30, "--timeout", 60)
    heard: dict[str, list] = {}
    for kind, name in (
        (MarkerArray, "markers"),
        (Image, "upwash"),
        (Image, "upwash_color"),
        (TransformStamped, "transform"),
    ):
        heard[name] = []
        visitor.node.create_subscription(kind, f"/flock/view/{name}", heard[name].append, 10)
    visitor.until(lambda: all(heard.values()))
    known = dict(visitor.node.get_topic_names_and_types())
    assert "/flock/view/markers" in known
    assert not any(name.endswith("/odometry") for name in known)
    check_markers(terminal, "bag", heard["markers"][-1], 2)
    image, told = heard["upwash"][-1], heard["transform"][-1]
    stamp = image.header.stamp
    expected = recorded(terminal, "bag", stamp.sec, stamp.nanosec, 2)
    pixels = np.frombuffer(image.data, dtype="<f4").reshape(image.height, image.width)
    assert pixels == pytest.approx(expected.upwash, rel=1e-4, abs=1e-6)
    picture = heard["upwash_color"][-1]
    assert (picture.encoding, len(picture.data)) == ("rgb8", 3 * picture.height * picture.width)
    stamp = told.header.stamp
    snapshot = recorded(terminal, "bag", stamp.sec, stamp.nanosec, 2).snapshot
    assert told.transform.translation.x == pytest.approx(snapshot.origin * snapshot.metre)
    assert "no clock sends the configuration" in job.stderr
    assert "3 birds, member 2 of 2" in job.stderr
    too_many = terminal.run("view", "--member", 3, "--timeout", 60)
    assert (too_many.status, too_many.error) == (
        2,
        "error: --member 3: must be in 1..2, the members of the flock",
    )
    for each in (job, player):
        each.interrupt()
        assert each.wait().status == 130


def test_odometry_of_all_birds_of_a_flight_is_heard(terminal: Terminal, visitor: Visitor) -> None:
    (terminal.directory / "flock.yaml").write_text(
        "/**: {ros__parameters: {birds: 3, wing_span: 1.6, min_drag_speed: 17.0}}"
    )
    birds = range(1, 4)
    flight = terminal.start("fly", "--config", "flock.yaml", "--t-max", 1e6, "--output", "flown")
    job = terminal.start("view", "--odometry", "--timeout", 60)
    heard: dict[int, list[Odometry]] = {bird: [] for bird in birds}
    for bird in birds:
        topic = f"/flock/bird_{bird:02d}/odometry"
        visitor.node.create_subscription(Odometry, topic, heard[bird].append, 10)
    visitor.until(lambda: all(heard.values()))
    told = {bird: heard[bird][-1] for bird in birds}
    stamps = {bird: 10**9 * m.header.stamp.sec + m.header.stamp.nanosec for bird, m in told.items()}
    flight.until(lambda: recorded_to(terminal.directory / "flown") >= max(stamps.values()))
    for each in (job, flight):
        each.interrupt()
        assert each.wait().status == 130
    for bird, message in told.items():
        snapshot = recorded(terminal, "flown", *divmod(stamps[bird], 10**9), 1).snapshot
        assert message.header.frame_id == "world"
        assert message.child_frame_id == f"bird_{bird:02d}"
        place, speed = message.pose.pose.position, message.twist.twist.linear
        assert place.x == pytest.approx(0.8 * snapshot.state.position[bird - 1])  # b = 0.8 m
        assert place.y == pytest.approx(-0.8 * snapshot.lateral[bird - 1])
        assert speed.x == pytest.approx(17.0 * snapshot.state.speed[bird - 1])
    assert told[1].pose.pose.position.y > told[2].pose.pose.position.y == 0.0


def test_missing_nav_msgs_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "nav_msgs.msg", None)
    with pytest.raises(FlockError, match="--odometry: needs nav_msgs; install it") as raised:
        viewer._message_class(messages.ODOMETRY)
    assert raised.value.exit_status == 2


def test_states_without_wings_are_refused_and_a_later_start_has_wings(terminal: Terminal) -> None:
    terminal.well("reference", *FLOCK, "--output", "bag")
    states = [f"/flock/bird_{bird:02d}/state" for bird in (1, 2, 3)]
    play = ("play", "bag", "--rate", 1, "--loop", "--start", 5)
    player = terminal.start(*play, "--topics", *states)
    refused = terminal.run("view", "--timeout", 8)
    assert refused.status == 2
    assert "the states of 3 birds are heard, but not their wings" in refused.error
    player.interrupt()
    assert player.wait().status == 130
    player = terminal.start(*play)
    job = terminal.start("view", "--timeout", 60)
    job.until_said("showing 3 birds")
    for each in (job, player):
        each.interrupt()
        assert each.wait().status == 130


def test_a_written_scene_is_played(terminal: Terminal, visitor: Visitor) -> None:
    terminal.well("reference", *FLOCK, "--output", "bag")
    terminal.well("view", "bag", "--output", "scene")
    topics = {"/flock/view/markers": MarkerArray, "/flock/view/upwash_color": Image}
    with BagReader(terminal.directory / "scene") as bag:
        written = {name: {data for _, _, data in bag.messages([name])} for name in topics}
    heard: dict[str, list[bytes]] = {name: [] for name in topics}
    for name, kind in topics.items():
        visitor.node.create_subscription(kind, name, heard[name].append, 10, raw=True)
    player = terminal.start("play", "scene", "--rate", 10, "--loop")
    visitor.until(lambda: all(len(told) > 2 for told in heard.values()))
    player.interrupt()
    assert player.wait().status == 130
    assert all(set(told) <= written[name] for name, told in heard.items())


class Client:
    """A Foxglove client of few words, by the protocol's text."""

    def __init__(self, connection: ClientConnection) -> None:
        self.connection = connection
        self.info = self.told("serverInfo")
        self.channels = {
            channel["topic"]: channel for channel in self.told("advertise")["channels"]
        }

    def told(self, what: str) -> dict:
        """Return the next text message of this kind; times and others are left aside."""
        for data in self._messages():
            if isinstance(data, str) and json.loads(data)["op"] == what:
                return json.loads(data)
        raise AssertionError(f"no {what} within {DEADLINE:g} s")

    def _messages(self) -> Iterator[str | bytes]:
        end = time.monotonic() + DEADLINE
        while (left := end - time.monotonic()) > 0.0:
            data = self.connection.recv(timeout=left)
            yield data if isinstance(data, str) else bytes(data)

    def hear(self, topics: list[str]) -> dict[str, tuple[int, bytes]]:
        """Subscribe, and return the first message of each topic, with its time in ns."""
        topic_of = dict(enumerate(topics, start=1))
        wanted = [{"id": k, "channelId": self.channels[t]["id"]} for k, t in topic_of.items()]
        self.connection.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))
        found: dict[str, tuple[int, bytes]] = {}
        for data in self._messages():
            if isinstance(data, bytes) and data[0] == 1:
                subscription, stamp = struct.unpack_from("<IQ", data, 1)
                found.setdefault(topic_of[subscription], (stamp, data[13:]))
            if len(found) == len(topics):
                return found
        raise AssertionError(f"only {list(found)} within {DEADLINE:g} s")


def served(job: Job) -> str:
    """Return the address that a viewer says it serves at."""
    return job.until(lambda: re.search(r"ws://[\d.]+:\d+", job.stderr))[0]


def test_a_flight_is_served_to_a_foxglove_client(terminal: Terminal) -> None:
    flight = terminal.start("fly", "--birds", 3, "--t-max", 1e6, "--output", "flown")
    job = terminal.start("view", "--foxglove", 0, "--timeout", 60)
    address = served(job)
    assert address.startswith("ws://127.0.0.1:")
    with connect(address, subprotocols=[SUBPROTOCOL]) as connection:  # type: ignore[list-item]
        assert connection.subprotocol == SUBPROTOCOL
        client = Client(connection)
        assert (client.info["op"], client.info["name"]) == ("serverInfo", "flock view")
        assert client.channels.keys() == viewer.FOXGLOVE_TYPES.keys()
        for topic, channel in client.channels.items():
            assert (channel["encoding"], channel["schemaEncoding"]) == ("cdr", "ros2msg")
            assert channel["schemaName"] == viewer.FOXGLOVE_TYPES[topic]
        heard = client.hear(list(client.channels))
    shown = max(stamp for stamp, _ in heard.values())
    flight.until(lambda: recorded_to(terminal.directory / "flown") >= shown)
    flight.interrupt()
    assert flight.wait().status == 130
    job.interrupt()
    assert job.wait().status == 130

    array = deserialize_message(heard["/flock/view/markers"][1], MarkerArray)
    check_markers(terminal, "flown", array, 1)
    stamp = array.markers[0].header.stamp
    assert heard["/flock/view/markers"][0] == stamp.sec * 1_000_000_000 + stamp.nanosec
    # What a client makes of the bytes, by the definitions that it is given and nothing else.
    for topic, (at, data) in heard.items():
        kind, text = client.channels[topic]["schemaName"], client.channels[topic]["schema"]
        store = get_typestore(Stores.EMPTY)
        store.register(get_types_from_msg(text, kind))
        message = store.deserialize_cdr(data, kind)
        if topic == "/tf":
            (told,) = message.transforms
            assert (told.header.frame_id, told.child_frame_id) == ("world", FRAME)
            seconds, nanoseconds = divmod(at, 1_000_000_000)
            snapshot = recorded(terminal, "flown", seconds, nanoseconds, 1).snapshot
            assert told.transform.translation.x == pytest.approx(snapshot.origin * snapshot.metre)
        elif topic.startswith("/flock/view/upwash"):
            assert message.encoding == ("rgb8" if topic.endswith("color") else "32FC1")
            assert len(message.data) == message.height * message.step


def test_a_port_that_is_taken_is_said_at_once() -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        with pytest.raises(FlockError, match="Address already in use; choose another") as raised:
            FoxgloveServer("127.0.0.1", port, viewer.FOXGLOVE_TYPES)
    assert str(raised.value).startswith(f"--foxglove {port}: can't be served on 127.0.0.1: ")
    assert raised.value.exit_status == 2


def test_a_silent_domain_is_named(terminal: Terminal) -> None:
    done = terminal.run("view", "--timeout", 0.1)
    assert done.status == 2
    domain = terminal.environment["ROS_DOMAIN_ID"]
    assert f"no flock found within 0.1 s on ROS domain {domain}" in done.error


def test_layouts_are_of_the_topics_that_are_published() -> None:
    rviz = yaml.safe_load((SHARE / "view.rviz").read_text(encoding="utf-8"))[
        "Visualization Manager"
    ]
    shown = {display["Class"]: display["Topic"]["Value"] for display in rviz["Displays"]}
    assert shown == {
        "rviz_default_plugins/MarkerArray": "/flock/view/markers",
        "rviz_default_plugins/Image": "/flock/view/upwash_color",
    }
    assert rviz["Global Options"]["Fixed Frame"] == FRAME
    layout = json.loads((SHARE / "foxglove.json").read_text(encoding="utf-8"))
    panels = layout["configById"]
    assert set(re.findall(r'"(\w+!\w+)"', json.dumps(layout["layout"]))) == panels.keys()
    assert panels["3D!flock"]["topics"].keys() == {"/flock/view/markers"}
    assert panels["3D!flock"]["followTf"] == FRAME
    assert panels["Image!upwash"]["imageMode"]["imageTopic"] == "/flock/view/upwash_color"
