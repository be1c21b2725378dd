# SPDX-License-Identifier: Apache-2.0
"""Topics, types and QoS profiles of hostile bags are read, or a topic is left out with a reason."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from mcap.writer import Writer
from rclpy.qos import DurabilityPolicy, HistoryPolicy, ReliabilityPolicy

from flock_sim.bag.reading.reader import BagReader
from flock_sim.errors import FlockError
from flock_tools.commands import play
from flock_tools.playback import topics
from flock_tools.playback.topics import DEEPEST, Selection, recorded_profiles, select
from support.foreign import STRING, Channel, profile, word, write_bag
from support.foreign_play import words
from support.tool_runs import error_of, json_of


def selected(directory: Path, *channels: Channel) -> Selection:
    bag = write_bag(directory, [*words(1), *((each, 0.0, word("a")) for each in channels)])
    with BagReader(bag) as reader:
        return select(reader)


@pytest.mark.parametrize("depth", ["2147483648", "18446744073709551616", "9" * 4000])
def test_a_huge_queue_is_reduced(tmp_path: Path, depth: str) -> None:
    offered = profile().replace("depth: 10", f"depth: {depth}")
    selection = selected(tmp_path / "bag", Channel("/a", profiles=offered))
    assert selection.topics["/a"].qos.depth == DEEPEST
    assert selection.notes == [f"/a: its queue depth of {depth} is reduced to {DEEPEST}"]


@pytest.mark.parametrize("depth", ["-1", "-2147483649", "0"])
def test_an_empty_queue_holds_one_message(depth: str) -> None:
    (found,) = recorded_profiles(profile().replace("depth: 10", f"depth: {depth}"))
    assert found.depth in (1, topics.DEFAULT_DEPTH)


@pytest.mark.parametrize(
    "text",
    [
        *(profile().replace("depth: 10", f"depth: {depth}") for depth in (".inf", ".nan", "1e9")),
        *("- " * 100_000, "[" * 100_000, "- depth: " + "9" * 5000, "a", "- 1", "{a: [}", "\0"),
        "- depth: 10\n  history: keep_all\n" * 100_000,  # longer than a genuine one
    ],
)
def test_profiles_that_can_not_be_read_are_none(text: str) -> None:
    assert recorded_profiles(text) == []


def test_a_text_that_stands_for_too_many_values_has_no_profiles() -> None:
    # Each key has the one before nine times: 9^30 copies for a loader that builds them.
    lines = ["- &a0 {depth: 5}"]
    for level in range(1, 31):
        lines.append(f"- &a{level} {{<<: [{', '.join([f'*a{level - 1}'] * 9)}]}}")
    assert recorded_profiles("\n".join(lines)) == []
    few = recorded_profiles("\n".join(lines[:3]))
    assert [each.depth for each in few] == [5] + [topics.DEFAULT_DEPTH] * 2


def test_numbers_and_words_are_the_same_policies() -> None:
    numbers = "- {history: 2, depth: 7, reliability: 2, durability: 1}"
    written = (
        "- {history: keep_all, depth: 7, reliability: best_effort, durability: transient_local}"
    )
    for text in (numbers, written):
        (found,) = recorded_profiles(text)
        assert found.depth == 7
        assert found.history == HistoryPolicy.KEEP_ALL
        assert found.reliability == ReliabilityPolicy.BEST_EFFORT
        assert found.durability == DurabilityPolicy.TRANSIENT_LOCAL


@pytest.mark.parametrize(
    "kind",
    [
        *("/", "String", "/msg/String", ".std_msgs/msg/String", "..os/msg/path", "std_msgs/msg/"),
        *("antigravity/msg/This", "this/msg/Zen", "\0/msg/A", "std_msgs/msg/" + "S" * 100_000),
    ],
)
def test_a_type_that_is_none_is_left_out_and_imports_nothing(tmp_path: Path, kind: str) -> None:
    selected(tmp_path / "sound")
    before = set(sys.modules)
    selection = selected(tmp_path / "bag", Channel("/a", kind))
    assert list(selection.topics) == ["/words"]
    assert selection.skipped == {"/a": f"its type {kind} can't be imported here"}
    assert set(sys.modules) == before


@pytest.mark.parametrize("definition", [b"", b"no \xff definition", b"string data\n" * 10**6])
def test_a_definition_that_is_none_does_not_matter(tmp_path: Path, definition: bytes) -> None:
    path = tmp_path / "a.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2", "theirs")
        schema = writer.register_schema(STRING, "ros2msg", definition)
        writer.add_message(writer.register_channel("/words", "cdr", schema), 0, word("a"), 0)
        writer.finish()
    with BagReader(path) as bag:
        assert list(select(bag).topics) == ["/words"]
        assert len(list(bag.messages())) == 1


def test_a_topic_of_the_player_with_another_type_is_left_out(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    said = [*words(1), (Channel("/parameter_events"), 0.0, word("a"))]
    bag = write_bag(tmp_path / "bag", said)
    reason = f"its type {STRING} is not rcl_interfaces/msg/ParameterEvent, which each node"
    note = f"note: /parameter_events is left out: {reason} publishes there\n"
    facts = json_of(play.tool, capsys, str(bag), "--rate", "0", notes=note)
    assert facts["topics"] == {"/words": 1}
    only = error_of(play.tool, capsys, str(bag), "--rate", "0", "--topics", "/parameter_events")
    assert reason in only


def test_the_number_of_played_topics_is_limited(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(topics, "MOST_TOPICS", 5)
    many = [Channel(f"/a{number}") for number in range(5)]
    with pytest.raises(FlockError, match="bag has 6 topics, more than the limit of 5: choose some"):
        selected(tmp_path / "bag", *many)
