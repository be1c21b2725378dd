# SPDX-License-Identifier: Apache-2.0
"""Foreign bags: intact messages of known types are played unchanged, others are reported."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
import yaml
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy

from flock_sim.bag.reading.reader import BagReader
from flock_sim.errors import FlockError
from flock_tools.playback.topics import DEEPEST, select
from support.foreign import SECOND, Channel, profile, word, write_bag, write_metadata
from support.foreign_play import LATCHED, WORDS, Played, heard, words


@pytest.fixture
def play(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Played:
    return Played(monkeypatch, capsys)


def test_a_channel_without_a_schema_is_named(tmp_path: Path, play: Played) -> None:
    bare = words(1, 2, channel=Channel("/bare", type=""))
    alone = write_bag(tmp_path / "alone", bare)
    assert "/bare: it has no schema" in play.error(alone)
    both = write_bag(tmp_path / "both", [*bare, *words(1, 2)])
    assert play(both)["topics"] == {"/words": 2}
    assert play.heard == heard(*words(1, 2))
    assert [note for note in play.notes if "/bare is left out: it has no schema" in note]


def test_a_name_without_a_slash_is_expanded_as_ros_does(tmp_path: Path, play: Played) -> None:
    said = words(1, 2, channel=Channel("words"))
    bag = write_bag(tmp_path / "bag", said)
    for options in ((), ("--topics", "words"), ("--topics", "/words")):
        facts = play(bag, *options)
        assert (facts["topics"], facts["skipped"]) == ({"/words": 2}, {})
        assert play.heard == [("/words", data) for *_, data in said]
    assert "did you mean '/words'" in play.error(bag, "--topics", "word")
    private = write_bag(tmp_path / "private", words(1, channel=Channel("~/words")))
    assert "ROS 2 does not allow its name" in play.error(private)


@pytest.mark.parametrize("chunk", [0, 1 << 20])
def test_messages_are_played_by_their_log_time(tmp_path: Path, play: Played, chunk: int) -> None:
    told = words(3, 1, 2)
    bag = write_bag(tmp_path / "bag", told, words(2.5, 0.5), chunk=chunk)
    assert play(bag)["reached"] == 2.5
    assert play.heard == heard(*words(0.5, 1, 2, 2.5, 3))
    for start in (0.5, 1, 2, 2.5, 3):
        play(bag, "--start", f"{start - 0.5:g}")
        assert play.heard == heard(*words(*(t for t in (0.5, 1, 2, 2.5, 3) if t >= start)))
    play(bag, "--start", "0.5", "--duration", "1")
    assert play.heard == heard(*words(1, 2))


def test_messages_of_one_time_keep_their_order(tmp_path: Path) -> None:
    other = Channel("/other")
    told = [(WORDS, 1.0, b"a"), (other, 1.0, b"b"), (WORDS, 0.5, b"c"), (other, 0.5, b"d")]
    told += [(WORDS, 1.0, b"e")]
    bag = write_bag(tmp_path / "bag", told, [(WORDS, 1.0, b"f"), (WORDS, 0.5, b"g")], chunk=0)
    with BagReader(bag) as opened:
        assert b"".join(data for *_, data in opened.by_time(opened.streams)) == b"cdgabef"
        assert (opened.first_time, opened.last_time) == (SECOND // 2, SECOND)


def test_what_was_latched_before_the_start_is_said_first(tmp_path: Path, play: Played) -> None:
    maps = Channel("/map", profiles=LATCHED)
    first, second = (maps, 1.0, word("old map")), (maps, 2.0, word("map"))
    said = words(1, 3, 5, 7)
    bag = write_bag(tmp_path / "bag", [first, second, *said], chunk=0)
    facts = play(bag, "--start", "3")
    assert play.heard == heard(second, *said[2:])
    assert facts["topics"] == {"/words": 2, "/map": 1}
    play(bag, "--start", "0.5")
    assert play.heard == heard(second, *said[1:])  # the second map comes in half a second
    play(bag)
    assert play.heard == heard(first, said[0], second, *said[1:])


def test_each_publisher_says_its_last_word_again(tmp_path: Path, play: Played) -> None:
    frames = Channel("/frames", profiles=LATCHED + profile(5, "transient_local"))
    told = words(1, 2, 3, channel=frames)
    bag = write_bag(tmp_path / "bag", [*told, *words(9, 10)])
    play(bag, "--start", "8")
    assert play.heard == heard(*told[1:], *words(9, 10))


def test_profiles_that_differ_in_depth_keep_durability(tmp_path: Path, play: Played) -> None:
    frames = Channel("/frames", profiles=LATCHED + profile(5, "transient_local"))
    play(write_bag(tmp_path / "bag", words(1, channel=frames)))
    assert play.selection is not None
    qos = play.selection.topics["/frames"].qos
    assert (qos.durability, qos.reliability, qos.depth) == (
        *(DurabilityPolicy.TRANSIENT_LOCAL, ReliabilityPolicy.RELIABLE),
        5,
    )


@pytest.mark.parametrize("depth", [2**31, 2**70])
def test_a_queue_that_is_too_deep_is_cut(tmp_path: Path, play: Played, depth: int) -> None:
    deep = Channel("/deep", profiles=profile(depth))
    play(write_bag(tmp_path / "bag", words(1, channel=deep)))
    assert play.heard == heard(*words(1, channel=deep))
    assert play.selection is not None
    assert play.selection.topics["/deep"].qos.depth == DEEPEST
    assert play.notes == [f"note: /deep: its queue depth of {depth} is reduced to {DEEPEST}"]


@pytest.mark.parametrize(
    ("other", "reason"),
    [
        (Channel("/words", encoding="json"), "its messages are encoded as 'json', not as cdr"),
        (Channel("words", encoding="json"), "its messages are encoded as 'json', not as cdr"),
        (Channel("/words", type="std_msgs/msg/Bool"), "its messages of type std_msgs/msg/Bool"),
        (Channel("/words", type="nobody_has/msg/This"), "can't be imported here"),
        (Channel("/words", type=""), "it has no schema"),
    ],
)
@pytest.mark.parametrize("files", [1, 2])
def test_of_a_topic_with_several_kinds_of_messages_one_is_played(
    tmp_path: Path, play: Played, other: Channel, reason: str, files: int
) -> None:
    said = words(1, 3)
    strange = [(other, 2.0, b'{"data":"two"}'), (other, 4.0, b"\x00\x01\x00\x00\x01")]
    # The other is never played, unless it is as good, and first.
    told = (said, strange) if files == 2 else (sorted([*said, *strange], key=lambda each: each[1]),)
    facts = play(write_bag(tmp_path / "bag", *told))
    assert play.heard == heard(*said)
    assert facts["topics"] == {"/words": 2}
    assert reason in facts["skipped"]["/words"]
    (note,) = play.notes
    assert note.startswith(f"note: some of /words is left out: {facts['skipped']['/words']}")


def test_a_type_that_is_another_than_the_installed_one_is_left_out(
    tmp_path: Path, play: Played
) -> None:
    old = Channel("/old", type_hash="RIHS01_" + 64 * "0")
    bag = write_bag(tmp_path / "bag", [*words(1, channel=old), *words(1)])
    facts = play(bag)
    assert play.heard == heard(*words(1))
    assert "is installed with another definition than in the bag" in facts["skipped"]["/old"]


def test_messages_that_cannot_be_published_are_left_out_and_counted(
    tmp_path: Path, play: Played
) -> None:
    bag = write_bag(tmp_path / "bag", words(1, 2, 3, 4))
    play.refused = lambda data: data in (word("at 2 s"), word("at 3 s"))
    facts = play(bag)
    assert play.heard == heard(*words(1, 4))
    assert (facts["messages"], facts["left_out"]) == (2, {"/words": 2})
    assert play.notes == ["note: messages of /words are left out: so it is"]


def test_a_first_stamp_of_0_hides_nothing(tmp_path: Path, play: Played) -> None:
    now = 1_700_000_000
    zero, since = (WORDS, 0.0, word("zero")), words(now, now + 1)
    bag = write_bag(tmp_path / "bag", [zero, *since])
    play(bag, "--start", f"{now}")
    assert play.heard == heard(*since)
    play(bag, "--start", f"{now}.000000001", "--duration", "2e9")
    assert play.heard == heard(*since[1:])
    assert "must be 1700000001 or less" in play.error(bag, "--start", "1700000002")
    assert "must be a number from 0" in play.error(bag, "--start", "nan")


def test_names_that_would_operate_the_terminal_are_escaped(tmp_path: Path, play: Played) -> None:
    evil = "/a\x1b]0;title\x07\x1b[31mred\n/two\x9b\u202e"
    bag = write_bag(tmp_path / "bag", [*words(1), *words(1, channel=Channel(evil))])
    facts = play(bag)
    assert facts["topics"] == {"/words": 1}
    (note,) = play.notes
    assert note.isprintable()
    assert "\\x1b]0;title\\x07" in note
    line = play.error(bag, "--topics", evil)
    assert line.isprintable()
    write_metadata(bag, ["bag_0.mcap", "gone\x1b[2J.mcap"])
    play(bag, "--topics", "/words")
    assert play.notes[0].isprintable()


EVIL = "open('executed', 'w').close()\n"


@pytest.mark.parametrize(
    "name", ["evil/msg/X", "evil.deep/msg/X", "evil/X", "../evil/msg/X", "this/msg/Zen", "/msg/X"]
)
def test_no_module_that_a_bag_names_is_imported(
    tmp_path: Path, play: Played, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    for package in ("evil", "evil/deep", "evil/msg", "evil/deep/msg"):
        (tmp_path / package).mkdir(exist_ok=True)
        (tmp_path / package / "__init__.py").write_text(EVIL, encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.chdir(tmp_path)
    monkeypatch.delitem(sys.modules, "this", raising=False)
    bag = write_bag(tmp_path / "bag", words(1, channel=Channel("/evil", type=name)))
    assert f"its type {name} can't be imported here" in play.error(bag)
    assert not (tmp_path / "executed").exists()
    assert not {"evil", "this"} & sys.modules.keys()


def test_only_messages_that_an_installed_package_lists_are_looked_up(tmp_path: Path) -> None:
    names = ["std_msgs/msg/Nothing", "std_srvs/srv/Empty", "std_msgs/msg/__init__", "rclpy/msg/X"]
    bare = [Channel(f"/t{k}", type=name) for k, name in enumerate(names)]
    bag = write_bag(tmp_path / "bag", *(words(1, channel=channel) for channel in bare))
    with BagReader(bag) as opened, pytest.raises(FlockError) as raised:
        select(opened)
    for name in names:
        assert f"its type {name} can't be imported here" in str(raised.value)


def test_a_schema_may_have_no_name_and_a_profile_any_shape(tmp_path: Path, play: Played) -> None:
    odd = [
        Channel("/a", profiles="- depth: .inf\n"),
        Channel("/b", profiles=10_000 * "["),
        Channel("/c", profiles=yaml.safe_dump([{"depth": -3, "history": 7}])),
    ]
    said = [message for channel in odd for message in words(1, channel=channel)]
    assert play(write_bag(tmp_path / "bag", said))["messages"] == 3


def test_topics_are_left_out_and_renamed_by_their_recorded_names(
    tmp_path: Path, play: Played
) -> None:
    camera, bare = Channel("/camera"), Channel("bare")
    latched = Channel("/map", profiles=LATCHED)
    said = [*words(1, 2, channel=camera), *words(1, 2), *words(2, channel=bare)]
    bag = write_bag(tmp_path / "bag", [*words(0, channel=latched), *said, *words(9)])
    facts = play(bag, "--exclude-topics", "bare", "/words", "-m", "/camera:=old", "map:=/old/map")
    assert facts["topics"] == {"/old/map": 1, "/old": 2}
    assert play.heard == [("/old/map", word("at 0 s")), *(("/old", d) for *_, d in said[:2])]
    play(bag, "-s", "1.5", "--topics", "/map", "/camera", "--remap", "/map:=/there")
    assert play.heard == [("/there", word("at 0 s")), ("/camera", word("at 2 s"))]
    facts = play(bag, "--remap", "/camera:=/words", "--exclude-topics", "bare", "/map")
    assert facts["topics"] == {"/words": 5}


@pytest.mark.parametrize(
    ("options", "words_of_error"),
    [
        (("--exclude-topics", "/wrods"), "--exclude-topics /wrods: did you mean '/words'?"),
        (("--exclude-topics", "/words"), "none of its topics can be played"),
        (("--remap", "/wrods:=/a"), "--remap /wrods: did you mean '/words'?"),
        (("--remap", "/words=/a"), "--remap /words=/a: must be OLD:=NEW"),
        (("--remap", "/words:=/a b"), "--remap /words:=/a b: must be OLD:=NEW"),
        (("--remap", "/words:=/a", "words:=/b"), "/words is already played as /a"),
        (("--clock", "0"), "--clock 0: must be a finite number above 0"),
        (("--delay", "-1"), "--delay -1: must be a number from 0"),
        (("-s", "mcap"), "--start mcap: must be a number from 0 to 1.84467e+10; leave out -s"),
    ],
)
def test_options_that_name_nothing_are_refused(
    tmp_path: Path, play: Played, options: tuple[str, ...], words_of_error: str
) -> None:
    assert words_of_error in play.error(write_bag(tmp_path / "bag", words(1)), *options)


def test_a_recorded_clock_is_left_out_if_the_player_has_a_clock(
    tmp_path: Path, play: Played
) -> None:
    recorded = Channel("/clock")
    bag = write_bag(tmp_path / "bag", [*words(1, channel=recorded), *words(1, 2)])
    facts = play(bag, "--clock", "100")
    assert play.heard == heard(*words(1, 2))
    assert play.clock == 100.0
    assert play.ticks[0] == SECOND
    assert facts["skipped"] == {"/clock": "the player publishes its own (--clock)"}
    facts = play(bag, "--clock", "--remap", "/clock:=/recorded_clock")
    assert facts["topics"] == {"/recorded_clock": 1, "/words": 2}
    assert play.clock == 40.0
    assert "the player publishes its own" in play.error(bag, "--clock", "1", "--topics", "/clock")
    play.ticks.clear()
    assert play(bag)["topics"] == {"/clock": 1, "/words": 2}
    assert (play.clock, play.ticks) == (None, [])


def test_what_ros2_bag_play_is_told_is_understood(tmp_path: Path, play: Played) -> None:
    bag = write_bag(tmp_path / "bag", words(1, 2, 3, 4))
    told = ("--start-offset", "1", "--playback-duration", "1", "-d", "0.001")
    facts = play(bag, *told, "-r", "1e9", "--disable-keyboard-controls")
    assert play.heard == heard(*words(2, 3))
    assert facts["rate"] == 1e9
