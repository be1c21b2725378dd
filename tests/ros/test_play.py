# SPDX-License-Identifier: Apache-2.0
"""Recorded messages are played byte for byte, and services control a playback."""

from __future__ import annotations

import signal
from pathlib import Path
from typing import Any

import pytest
from builtin_interfaces.msg import Time as Stamp
from geometry_msgs.msg import PoseStamped
from rclpy.serialization import serialize_message
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from rosgraph_msgs.msg import Clock
from std_msgs.msg import String

from flock_interfaces import srv
from flock_interfaces.msg import BirdState
from flock_sim.bag.definitions import Definition, installed_definition
from flock_sim.bag.reading.reader import BagReader
from flock_sim.bag.topic import Topic
from flock_sim.bag.writing.writer import BagWriter
from flock_sim.console.arguments import run_tool
from flock_sim.messages import topics
from flock_tools.commands.play import tool
from flock_tools.playback.topics import select
from support.foreign import Channel, Message, profile, word, write_bag
from support.terminal import Terminal
from support.visitor import Visitor

FLOCK = ("--birds", 3, "--t-max", 300, "--record-every", 2)
PLAYER = "/flock/player"
DEEP = 1000
"""A queue for all that any of the bags holds on a topic."""

SECOND = 10**9


def reference(terminal: Terminal) -> Path:
    terminal.well("reference", *FLOCK, "--output", "bag")
    return terminal.directory / "bag"


def listen(visitor: Visitor, bag: Path) -> dict[str, list[bytes]]:
    """Return lists that grow with the bytes heard on every topic of `bag`."""
    with BagReader(bag) as opened:
        kinds = {name: topic.type for name, topic in select(opened).topics.items()}
    return {name: visitor.hear(kind, name, raw=True, depth=DEEP) for name, kind in kinds.items()}


def until_met(visitor: Visitor) -> None:
    """Wait until the player is connected to everything that the visitor listens to."""
    visitor.until(lambda: all(s.get_publisher_count() for s in visitor.node.subscriptions))


def recorded(bag: Path) -> dict[str, list[bytes]]:
    """Return the bytes on every topic."""
    with BagReader(bag) as opened:
        found: dict[str, list[bytes]] = {name: [] for name in opened.topics}
        for name, _, data in opened.messages():
            found[name].append(data)
    return found


def ask(visitor: Visitor, kind: str, **request: Any) -> Any:
    """Ask the player; `kind` is the type of the service, whose name it has in small letters."""
    name = "".join(f"_{letter.lower()}" if letter.isupper() else letter for letter in kind)[1:]
    return visitor.ask(getattr(srv, kind), f"{PLAYER}/{name}", **request)


def seek(visitor: Visitor, stamp: int) -> bool:
    second, rest = divmod(stamp, SECOND)
    return bool(ask(visitor, "Seek", time=Stamp(sec=second, nanosec=rest)).success)


@pytest.mark.parametrize("rate", [0, 50])
def test_every_byte_is_played_in_order(terminal: Terminal, visitor: Visitor, rate: int) -> None:
    bag = reference(terminal)
    heard, expected = listen(visitor, bag), recorded(bag)
    job = terminal.start("play", "bag", "--rate", rate, "--paused", "--json")
    until_met(visitor)
    ask(visitor, "Resume")
    visitor.until(lambda: sum(map(len, heard.values())) == sum(map(len, expected.values())))
    done = job.wait()
    assert done.status == 0, done.stderr
    assert heard == expected
    assert done.json["topics"] == {name: len(data) for name, data in expected.items()}


def test_a_playback_is_operated_by_the_services_of_rosbag2(
    terminal: Terminal, visitor: Visitor
) -> None:
    bag = reference(terminal)
    heard = listen(visitor, bag)
    with BagReader(bag) as opened:
        order = list(opened.messages())
    job = terminal.start("play", "bag", "--paused", "--json")
    until_met(visitor)
    assert ask(visitor, "IsPaused").paused
    assert ask(visitor, "GetRate").rate == 1.0

    for topic, _, data in order[:6]:
        before = len(heard[topic])
        assert ask(visitor, "PlayNext").success
        visitor.until(lambda topic=topic, n=before: len(heard[topic]) > n)
        assert heard[topic][before:] == [data]
    assert sum(map(len, heard.values())) == 6

    last = order[-1][1]
    assert not seek(visitor, last + SECOND)
    half = order[len(order) // 2][1]
    assert seek(visitor, half - 1)
    expected = [data for topic, stamp, data in order if topic == "/clock" and stamp >= half]
    begun = len(heard["/clock"])

    assert not ask(visitor, "SetRate", rate=-1.0).success
    assert ask(visitor, "SetRate", rate=1e-3).success
    assert ask(visitor, "GetRate").rate == 1e-3
    ask(visitor, "TogglePaused")
    assert not ask(visitor, "IsPaused").paused
    assert not ask(visitor, "PlayNext").success
    ask(visitor, "Pause")
    assert ask(visitor, "IsPaused").paused
    assert ask(visitor, "SetRate", rate=1e3).success
    ask(visitor, "Resume")
    visitor.until(lambda: len(heard["/clock"]) == begun + len(expected))
    assert heard["/clock"][begun:] == expected
    assert job.wait().status == 0


def test_a_loop_is_played_until_it_is_stopped(terminal: Terminal, visitor: Visitor) -> None:
    bag = reference(terminal)
    heard = visitor.hear(BirdState, topics.state_topic(1), raw=True, depth=DEEP)
    states = recorded(bag)[topics.state_topic(1)]
    job = terminal.start(
        # Some hundred messages a second: a queue would overflow with those of a higher rate.
        *("play", "bag", "--loop", "--paused", "--json", "--rate", 5),
        *("--start", 2, "--duration", 1, "--topics", topics.state_topic(1)),
    )
    until_met(visitor)
    ask(visitor, "Resume")
    with BagReader(bag) as opened:
        part = [
            data
            for _, _, data in opened.messages([topics.state_topic(1)], 2 * SECOND, 3 * SECOND + 1)
        ]
    assert 5 < len(part) < len(states)
    visitor.until(lambda: len(heard) > 3 * len(part) or not job.running)
    assert job.running, (job.process.returncode, job.stdout, job.stderr)
    done = visitor.stop_player(job)
    assert done.status == 0, done.stderr
    assert heard == (part * (len(heard) // len(part) + 1))[: len(heard)]


def test_ctrl_c_ends_a_pause_and_says_what_was_played(terminal: Terminal) -> None:
    reference(terminal)
    job = terminal.start("play", "bag", "--paused", "--json").until_connected()
    job.interrupt()
    done = job.wait()
    assert done.status == 128 + signal.SIGINT
    assert done.json["messages"] == 0


STRANGE = "nobody_has/msg/This"


def strange_definition(name: str) -> Definition:
    """Define what is installed, and one type that is not."""
    if name == STRANGE:
        return installed_definition("std_msgs/msg/String")
    return installed_definition(name)


def foreign(directory: Path, names: tuple[str, ...], messages: int) -> list[bytes]:
    """Write a bag of no flock: `messages` on each topic, those of /strange of an unknown type."""
    # Of a length that is a multiple of 4: to that Fast DDS fills up what it sends.
    said = [serialize_message(String(data=f"{k:03}" + "four" * (k % 7))) for k in range(messages)]
    kinds = {"/strange": STRANGE, "/words": "std_msgs/msg/String"}
    chosen = [Topic(name, kinds[name]) for name in names]
    with BagWriter(directory, chosen, {}, define=strange_definition) as bag:
        for k, data in enumerate(said):
            for name in names:
                bag.write(name, 5 * SECOND + k, data)
    return said


def test_a_bag_of_others_is_played_and_nothing_pushed_out_of_short_queues(
    terminal: Terminal, visitor: Visitor
) -> None:
    bag = terminal.directory / "others"
    said = foreign(bag, ("/strange", "/words"), 300)
    heard: list[bytes] = []
    visitor.node.create_subscription(String, "/words", heard.append, DEEP, raw=True)
    job = terminal.start("play", "others", "--rate", 0, "--paused", "--json")
    until_met(visitor)
    ask(visitor, "Resume")
    visitor.until(lambda: len(heard) == len(said))
    assert heard == said
    done = job.wait()
    assert done.status == 0, done.stderr
    assert done.json["topics"] == {"/words": 300}
    assert list(done.json["skipped"]) == ["/strange"]
    assert f"its type {STRANGE} can't be imported here" in done.stderr


def test_a_bag_that_another_library_wrote_is_played(terminal: Terminal, visitor: Visitor) -> None:
    # rosbags, which shares nothing with our writer.
    store = get_typestore(Stores.ROS2_JAZZY)
    strings, poses = "std_msgs/msg/String", "geometry_msgs/msg/PoseStamped"
    with Writer(
        terminal.directory / "theirs", version=9, storage_plugin=StoragePlugin.MCAP
    ) as writer:
        words = writer.add_connection("/words", strings, typestore=store)
        places = writer.add_connection("/places", poses, typestore=store)
        said = [bytes(serialize_message(String(data=f"{k:07}"))) for k in range(40)]
        been = [bytes(serialize_message(PoseStamped())) for _ in range(40)]
        for k, (word, place) in enumerate(zip(said, been, strict=True)):
            writer.write(words, SECOND + k * 1000, word)
            writer.write(places, SECOND + k * 1000, place)
    heard: dict[str, list[bytes]] = {"/words": [], "/places": []}
    for topic, kind in (("/words", String), ("/places", PoseStamped)):
        visitor.node.create_subscription(kind, topic, heard[topic].append, DEEP, raw=True)
    job = terminal.start("play", "theirs", "--rate", 0, "--paused", "--json")
    until_met(visitor)
    ask(visitor, "Resume")
    visitor.until(lambda: sum(map(len, heard.values())) == 80)
    done = job.wait()
    assert done.status == 0, done.stderr
    assert heard == {"/words": said, "/places": been}
    assert done.json["topics"] == {"/words": 40, "/places": 40}


def test_a_bag_of_every_fault_is_played_around_its_faults(
    terminal: Terminal, visitor: Visitor
) -> None:
    clock = Channel("/clock", type="rosgraph_msgs/msg/Clock")
    said = Channel("words")
    deep = Channel("/map", profiles=profile(2**31, "transient_local"))
    times = [bytes(serialize_message(Clock(clock=Stamp(sec=k)))) for k in range(6)]
    messages: list[Message] = [
        (deep, 0.0, word("old map")),
        (deep, 1.0, word("map")),
        *((clock, float(k), times[k]) for k in range(6)),
        (clock, 4.2, times[4] + bytes(500)),  # longer than any Clock is
        (clock, 4.4, b"\x28\xb5\x2f\xfd" + times[4]),  # what compressed data begins with
        (clock, 4.6, b"\x00\x01"),
        *((said, float(k), word(f"at {k} s.")) for k in range(6)),
    ]
    write_bag(terminal.directory / "bag", messages)
    heard: list[bytes] = []
    for kind, topic in ((Clock, "/clock"), (String, "/words")):
        visitor.node.create_subscription(kind, topic, heard.append, DEEP, raw=True)
    job = terminal.start("play", "bag", "--rate", 0, "--start", 3, "--paused", "--json")
    until_met(visitor)
    ask(visitor, "Resume")
    expected = sorted([*times[3:], *(word(f"at {k} s.") for k in (3, 4, 5))])
    visitor.until(lambda: len(heard) == len(expected))
    done = job.wait()
    assert done.status == 0, done.stderr
    assert sorted(heard) == expected
    assert done.json["topics"] == {"/map": 1, "/clock": 3, "/words": 3}
    assert done.json["left_out"] == {"/clock": 3}
    assert "messages of /clock are left out: 512 bytes do not fit its type" in done.stderr
    assert "/map: its queue depth of 2147483648 is reduced" in done.stderr


def test_the_clock_of_the_player_and_other_names_are_heard(
    terminal: Terminal, visitor: Visitor
) -> None:
    recorded_clock, said = Channel("/clock", type="rosgraph_msgs/msg/Clock"), Channel("words")
    wrong = bytes(serialize_message(Clock(clock=Stamp(sec=77))))
    messages: list[Message] = [(recorded_clock, 5.0, wrong)]
    messages += [(said, 5.0 + k / 100, word(f"number {k}")) for k in range(51)]
    write_bag(terminal.directory / "bag", messages)
    order: list[str] = []
    times: list[int] = []

    def hear_time(clock: Clock) -> None:
        times.append(clock.clock.sec * SECOND + clock.clock.nanosec)

    visitor.node.create_subscription(Clock, "/clock", hear_time, DEEP)
    visitor.node.create_subscription(String, "/other", lambda said: order.append(said.data), DEEP)
    options = ("--clock", 100, "--remap", "/words:=other", "-p", "--json")
    job = terminal.start("play", "bag", *options)
    until_met(visitor)
    visitor.until(lambda: len(times) > 2)
    assert set(times) == {5 * SECOND}  # in the pause at the beginning
    for _ in range(3):
        assert ask(visitor, "PlayNext").success
    visitor.until(lambda: times[-1] == 5 * SECOND + 2 * SECOND // 100)
    ask(visitor, "Resume")
    visitor.until(lambda: len(order) == 51)
    done = job.wait()
    assert done.status == 0, done.stderr
    assert order == [f"number {k}" for k in range(51)]
    assert done.json["topics"] == {"/other": 51}
    assert "/clock is left out: the player publishes its own" in done.stderr
    assert times == sorted(times)
    assert times[-1] <= 5.5 * SECOND


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("none",), "there is no bag none"),
        (("nothing",), "there is no .mcap file in it"),
        (("sqlite",), "or use ros2 bag convert"),
        (("empty",), "it has no messages"),
        (("strange",), "none of its topics can be played"),
        (("words", "--rate", "-1"), "--rate -1: must be a number from 0"),
        (("words", "--rate", "nan"), "--rate nan: must be a number from 0"),
        (("words", "--start", "9"), "--start 9: must be 0 or less"),
        (("words", "--start", "-1"), "--start -1: must be a number from 0"),
        (("words", "--duration", "-1"), "--duration -1: must be a finite number above 0"),
        (("words", "--topics", "/word"), "--topics /word: did you mean '/words'?"),
    ],
)
def test_bad_input_is_refused_in_one_line(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: tuple[str, ...],
    words: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("nothing", "sqlite"):
        (tmp_path / name).mkdir()
    (tmp_path / "sqlite" / "sqlite_0.db3").touch()
    foreign(tmp_path / "empty", ("/words",), 0)
    foreign(tmp_path / "strange", ("/strange",), 1)
    foreign(tmp_path / "words", ("/words",), 1)
    assert run_tool(tool, arguments) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("error: ")
    assert words in line
