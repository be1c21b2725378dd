# SPDX-License-Identifier: Apache-2.0
"""Reading Flock's bags, foreign bags, and files that are no bags."""

import os
import struct
from collections.abc import Callable
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType, Writer

from flock_sim.bag.reading import mcap_file
from flock_sim.bag.reading.reader import BagReader
from flock_sim.bag.topic import Topic
from flock_sim.bag.writing.writer import BagWriter
from flock_sim.errors import FlockError

TOPICS = [Topic(f"/flock/bird_{i:02d}/state", "std_msgs/msg/Header") for i in range(1, 4)]
Row = tuple[str, int, bytes]


def rows(count: int) -> list[Row]:
    return [
        (TOPICS[i % 3].name, 10 * (i // 3), b"%d " % i + bytes(range(i % 40))) for i in range(count)
    ]


def write_bag(directory: Path, messages: list[Row], every: int = 30) -> Path:
    """A bag with a chunk for `every` messages; returns the file."""
    with BagWriter(directory, TOPICS, {"flock": {"birds": "3"}}) as bag:
        for number, (topic, time, data) in enumerate(messages, start=1):
            bag.write(topic, time, data)
            if number % every == 0:
                bag.flush()
    return bag.path


def chunk_ends(path: Path) -> list[int]:
    """For each chunk, where it ends in the file (message indexes apart)."""
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    return [index.chunk_start_offset + index.chunk_length for index in summary.chunk_indexes]


def test_a_bag_reads_back_as_it_was_written(tmp_path: Path) -> None:
    messages = rows(300)
    path = write_bag(tmp_path / "bag", messages)
    for where in (path.parent, path, str(path.parent)):
        with BagReader(where) as bag:
            assert list(bag.messages()) == messages
            assert bag.missing is None
            assert bag.topics == {topic.name: topic.type for topic in TOPICS}
            assert bag.message_counts == {topic.name: 100 for topic in TOPICS}
            assert bag.last_time == 990
            assert bag.metadata("flock") == {"birds": "3"}


@pytest.mark.parametrize(
    ("topics", "start", "end"),
    [
        (None, 500, None),
        (None, None, 500),
        (None, 501, 509),
        ([TOPICS[1].name], 200, 800),
        ([TOPICS[1].name, "/nobody"], None, None),
        ([], None, None),
        (None, 991, None),
    ],
)
@pytest.mark.parametrize("summary", [True, False])
def test_topics_and_times_select(
    tmp_path: Path, topics: list[str] | None, start: int | None, end: int | None, summary: bool
) -> None:
    messages = rows(300)
    path = write_bag(tmp_path / "bag", messages)
    if not summary:
        os.truncate(path, chunk_ends(path)[-1])
    with BagReader(path) as bag:
        assert list(bag.messages(topics, start, end)) == [
            (topic, time, data)
            for topic, time, data in messages
            if (topics is None or topic in topics)
            and (start is None or time >= start)
            and (end is None or time < end)
        ]


def test_the_last_row_of_a_long_bag_is_read_without_the_rest(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_bag(tmp_path / "bag", [(t, i, os.urandom(2_000)) for t, i, _ in rows(3_000)])
    asked = 0
    pread = os.pread

    def count(fd: int, length: int, offset: int) -> bytes:
        nonlocal asked
        asked += length
        return pread(fd, length, offset)

    monkeypatch.setattr(os, "pread", count)
    with BagReader(path) as bag:
        last = list(bag.messages(start=bag.last_time))
    assert [topic for topic, _, _ in last] == [topic.name for topic in TOPICS]
    assert asked < path.stat().st_size / 20


def test_two_metadata_records_of_one_name_need_no_scan(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # rosbag2 writes its metadata.yaml into a file when it opens it, and again when it closes it.
    path = tmp_path / "theirs.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start("ros2", "theirs")
        channel = writer.register_channel("/words", "cdr", 0)
        writer.add_metadata("rosbag2", {"serialized_metadata": "at first"})
        writer.add_message(channel, 7, b"", 7)
        writer.add_metadata("rosbag2", {"serialized_metadata": "at last"})
        writer.finish()
    monkeypatch.setattr(mcap_file, "scanned", lambda fd: pytest.fail("the whole file is read"))
    with BagReader(path) as bag:
        assert bag.metadata("rosbag2") == {"serialized_metadata": "at last"}
        assert bag.message_counts == {"/words": 1}


@pytest.mark.parametrize("size", [7, 1 << 31])
def test_a_damaged_index_of_a_chunk_hides_no_message(tmp_path: Path, size: int) -> None:
    path = tmp_path / "theirs.mcap"
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=100, enable_crcs=False)
        writer.start("ros2", "theirs")
        channel = writer.register_channel("/words", "cdr", 0)
        for time in range(50):
            writer.add_message(channel, time, bytes(10), time)
        writer.finish()
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    index = summary.chunk_indexes[1]
    fields = struct.pack(
        "<QQQQ",
        *(index.message_start_time, index.message_end_time),
        *(index.chunk_start_offset, index.chunk_length),
    )
    content = path.read_bytes()
    assert content.count(fields) == 1
    at = content.index(fields) + len(fields)
    path.write_bytes(content[:at] + struct.pack("<I", size) + content[at + 4 :])
    with BagReader(path) as bag:
        assert [time for _, time, _ in bag.messages()] == list(range(50))
        assert bag.missing is not None
        assert "the summary is damaged (the channels in the index" in bag.missing


@pytest.mark.parametrize("compression", list(CompressionType))
@pytest.mark.parametrize("chunking", [True, False])
@pytest.mark.parametrize("index", [IndexType.ALL, IndexType.NONE])
@pytest.mark.parametrize("summary", [True, False])
@pytest.mark.parametrize("torn", [True, False])
def test_other_peoples_bags_are_read(
    tmp_path: Path,
    compression: CompressionType,
    chunking: bool,
    index: IndexType,
    summary: bool,
    torn: bool,
) -> None:
    messages = rows(200)
    path = tmp_path / "theirs.mcap"
    with path.open("wb") as file:
        writer = Writer(
            file,
            chunk_size=1_000,
            compression=compression,
            use_chunking=chunking,
            index_types=index,
            use_statistics=summary,
            repeat_channels=summary,
            repeat_schemas=summary,
            use_summary_offsets=summary,
        )
        writer.start("ros2", "theirs")
        schema = writer.register_schema("std_msgs/msg/Header", "ros2msg", b"")
        channels = {t.name: writer.register_channel(t.name, "cdr", schema) for t in TOPICS}
        writer.add_metadata("note", {"by": "them"})
        for topic, time, data in messages:
            writer.add_message(channels[topic], time, data, time)
        writer.flush()
        end_of_data = file.tell()
        writer.finish()
    if torn:
        os.truncate(path, end_of_data - 1)
    with BagReader(path) as bag:
        found = list(bag.messages())
        assert bag.topics == {topic.name: "std_msgs/msg/Header" for topic in TOPICS}
        assert bag.metadata("note") == {"by": "them"}
        if torn:
            assert found == messages[: len(found)]
            assert len(found) > 150
            assert bag.missing is not None
        else:
            assert found == messages
            assert bag.missing is None
        assert bag.last_time == found[-1][1]
        assert list(bag.messages([TOPICS[0].name], 100, 200)) == [
            row for row in found if row[0] == TOPICS[0].name and 100 <= row[1] < 200
        ]


def test_a_split_bag_is_read_in_the_order_of_its_files(tmp_path: Path) -> None:
    messages = rows(360)
    bag = tmp_path / "split"
    bag.mkdir()
    for number in range(12):
        part = write_bag(tmp_path / f"part{number}", messages[30 * number : 30 * number + 30])
        part.rename(bag / f"split_{number}.mcap")
    (bag / "metadata.yaml").touch()
    with BagReader(bag) as reader:
        assert list(reader.messages()) == messages
        assert reader.message_counts == {topic.name: 120 for topic in TOPICS}
        assert reader.last_time == messages[-1][1]


def test_several_streams_of_one_reader_do_not_disturb_each_other(tmp_path: Path) -> None:
    messages = rows(300)
    path = write_bag(tmp_path / "bag", messages)
    with BagReader(path) as bag:
        pairs = list(zip(bag.messages(), bag.messages(), strict=True))
    assert pairs == [(row, row) for row in messages]


@pytest.mark.parametrize(
    ("make", "reason"),
    [
        (lambda p: None, "there is no bag"),
        (lambda p: p.mkdir(), "there is no .mcap file in it"),
        (lambda p: p.write_bytes(b""), "is an empty file"),
        (lambda p: p.write_text("time,position\n0,1\n"), "is not an MCAP file"),
        (
            lambda p: p.write_bytes(b"SQLite format 3\0"),
            "given is an SQLite bag of rosbag2, not MCAP: .* --dst-storage mcap, or use ros2 bag",
        ),
        (lambda p: p.write_bytes(b"#ROSBAG V2.0\n"), "is a bag of ROS 1, .* --src .*/given --dst"),
        (
            lambda p: (p.mkdir(), (p / "x_0.db3").write_bytes(b"SQLite format 3\0")),
            r"it has an SQLite bag of rosbag2 \(x_0.db3\): .* rosbags-convert --src .*/given --dst",
        ),
        (
            lambda p: (p.mkdir(), (p / "x_0.db3.zstd").write_bytes(b"")),
            r"SQLite bag of rosbag2 \(x_0.db3.zstd\): .* --src .*/given --dst",
        ),
        (
            lambda p: (p.mkdir(), (p / "drive.bag").write_bytes(b"#ROSBAG V2.0\n")),
            r"it has a bag of ROS 1 \(drive.bag\): .* --src .*/given/drive.bag --dst",
        ),
        (lambda p: (p.mkdir(), (p / "x_0.mcap").write_bytes(b"")), "x_0.mcap is an empty file"),
        (lambda p: (p / "x_0.mcap").mkdir(parents=True), "x_0.mcap can't be read: Is a dir"),
        (lambda p: p.symlink_to(p), "can't be read: Too many levels"),
    ],
)
def test_what_is_no_bag_is_refused_in_one_line(
    tmp_path: Path, make: Callable[[Path], object], reason: str
) -> None:
    path = tmp_path / "given"
    make(path)
    with pytest.raises(FlockError, match=reason) as refused:
        BagReader(path)
    assert "given" in str(refused.value)
    assert "\n" not in str(refused.value)


def test_metadata_that_is_not_there_is_told(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "bag", rows(3))
    with BagReader(path) as bag, pytest.raises(FlockError, match="no metadata record 'other'"):
        bag.metadata("other")
