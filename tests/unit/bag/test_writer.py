# SPDX-License-Identifier: Apache-2.0
"""Bags as other programs read them: checked by mcap's own reader and by `rosbags`."""

import os
import signal
import subprocess
import sys
import textwrap
from collections import Counter
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap.records import DataEnd, Message
from mcap.stream_reader import StreamReader

from flock_sim.bag import limits
from flock_sim.bag.reading.reader import BagReader
from flock_sim.bag.topic import Topic
from flock_sim.bag.writing.writer import BagWriter
from flock_sim.errors import FlockError, RunFailed

STATE = "flock_interfaces/msg/BirdState"
TOPICS = [
    Topic("/flock/bird_01/state", STATE),
    Topic("/flock/bird_02/state", STATE, depth=0, history="keep_all"),
    Topic("/clock", "rosgraph_msgs/msg/Clock", reliability="best_effort", depth=1),
    Topic("/flock/bird_01/wing", "flock_interfaces/msg/BirdWing", durability="transient_local"),
]
METADATA = {"flock": {"birds": "2", "note": "Gänse 🪿 «∞»", "empty": ""}, "run": {}}


def payloads(count: int) -> list[tuple[str, int, bytes]]:
    """Topic, log time and data of `count` messages; every length modulo 8 is met."""
    return [
        (TOPICS[i % 3].name, 1_000 + 7 * i, bytes((i * k) % 251 for k in range(20 + i % 50)))
        for i in range(count)
    ]


def write_bag(directory: Path, messages: list[tuple[str, int, bytes]], **options: int) -> Path:
    with BagWriter(directory, TOPICS, METADATA, **options) as bag:
        for topic, time, data in messages:
            bag.write(topic, time, data)
    return directory / f"{directory.name}_0.mcap"


def test_mcaps_own_reader_finds_every_message_of_every_chunk(tmp_path: Path) -> None:
    messages = payloads(2_000)
    path = write_bag(tmp_path / "bag", messages, chunk_size=4_096)
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert reader.get_header().profile == "ros2"
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert len(summary.chunk_indexes) == summary.statistics.chunk_count > 10
        names = {number: channel.topic for number, channel in summary.channels.items()}
        counts = summary.statistics.channel_message_counts
        assert {names[number]: count for number, count in counts.items()} == Counter(
            topic for topic, _, _ in messages
        )
        assert {schema.encoding for schema in summary.schemas.values()} == {"ros2msg"}
        assert [
            (channel.topic, message.log_time, message.data)
            for _, channel, message in reader.iter_messages()
        ] == messages
        only = [m.data for _, _, m in reader.iter_messages(topics=["/clock"], starting_at=5_000)]
        assert only == [d for topic, t, d in messages if topic == "/clock" and t >= 5_000]
        assert {record.name: record.metadata for record in reader.iter_metadata()} == METADATA


def test_the_crc_of_all_data_fits(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "bag", payloads(300), chunk_size=4_096)
    with path.open("rb") as file:
        records = list(StreamReader(file, validate_crcs=True).records)
    assert sum(isinstance(record, Message) for record in records) == 300
    (end,) = (record for record in records if isinstance(record, DataEnd))
    assert end.data_section_crc != 0


def test_two_writes_give_the_same_bytes(tmp_path: Path) -> None:
    messages = payloads(1_000)
    one = write_bag(tmp_path / "a" / "bag", messages, chunk_size=8_192)
    two = write_bag(tmp_path / "b" / "bag", messages, chunk_size=8_192)
    assert one.read_bytes() == two.read_bytes()
    assert (one.parent / "metadata.yaml").read_bytes() == (
        two.parent / "metadata.yaml"
    ).read_bytes()


def test_a_complete_bag_holds_the_recording_and_its_metadata_only(tmp_path: Path) -> None:
    write_bag(tmp_path / "bag", payloads(10))
    assert {entry.name for entry in (tmp_path / "bag").iterdir()} == {
        "bag_0.mcap",
        "metadata.yaml",
    }


def test_topics_go_by_name_or_by_place_and_times_need_no_order(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag", TOPICS, {}) as bag:
        bag.write(2, 9, b"late", publish_time=4, sequence=3)
        bag.write("/clock", 5, b"early")
    with (tmp_path / "bag" / "bag_0.mcap").open("rb") as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        found = [
            (m.data, m.log_time, m.publish_time, m.sequence) for _, _, m in reader.iter_messages()
        ]
    assert found == [(b"early", 5, 5, 0), (b"late", 9, 4, 3)]
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_start_time == 5
    assert summary.statistics.message_end_time == 9


def test_a_message_that_is_refused_leaves_nothing_in_the_chunk(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag", TOPICS, {}) as bag:
        bag.write(0, 1, b"one")
        with pytest.raises(Exception, match="argument"):  # struct.error: a time before 0
            bag.write(0, -1, b"negative")
        with pytest.raises(KeyError):
            bag.write("/nobody", 2, b"unknown")
        bag.write(0, 2, b"two")
    with BagReader(tmp_path / "bag") as reader:
        assert [data for _, _, data in reader.messages()] == [b"one", b"two"]


def test_what_was_flushed_outlives_a_kill_9(tmp_path: Path) -> None:
    script = textwrap.dedent(
        """
        import os, signal, sys
        from flock_sim.bag.topic import Topic
        from flock_sim.bag.writing.writer import BagWriter
        bag = BagWriter(sys.argv[1], [Topic("/clock", "rosgraph_msgs/msg/Clock")], {"flock": {}})
        for step in range(100):
            bag.write(0, step, b"data %d" % step)
            if step % 10 == 9 and step < 60:
                bag.flush()
        assert bag.messages_safe == 60
        os.kill(os.getpid(), signal.SIGKILL)
        """
    )
    done = subprocess.run(
        [sys.executable, "-c", script, tmp_path / "bag"], env=os.environ, check=False
    )
    assert done.returncode == -signal.SIGKILL
    with BagReader(tmp_path / "bag") as bag:
        assert [data for _, _, data in bag.messages()] == [b"data %d" % i for i in range(60)]
        assert bag.metadata("flock") == {}
        assert bag.missing is not None
        assert "\n" not in bag.missing


def test_a_closed_bag_takes_nothing_more(tmp_path: Path) -> None:
    bag = BagWriter(tmp_path / "bag", TOPICS, {})
    bag.write(0, 1, b"one")
    bag.close()
    before = bag.path.read_bytes()
    bag.close()
    with pytest.raises(RunFailed, match="closed"):
        bag.write(0, 2, b"two")
    with pytest.raises(RunFailed, match="closed"):
        bag.flush()
    assert bag.path.read_bytes() == before


def test_an_error_in_the_recorder_still_completes_the_bag(tmp_path: Path) -> None:
    def stop_in_mid_flight() -> None:
        with BagWriter(tmp_path / "bag", TOPICS, {}) as bag:
            bag.write(0, 1, b"one")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        stop_in_mid_flight()
    with BagReader(tmp_path / "bag") as reader:
        assert reader.missing is None
        assert len(list(reader.messages())) == 1


@pytest.mark.parametrize("kind", ["full", "file", "under a file"])
def test_a_directory_that_is_taken_is_refused_and_left_alone(tmp_path: Path, kind: str) -> None:
    target = tmp_path / "out"
    if kind == "full":
        target.mkdir()
        (target / "thesis.tex").write_text("dear")
    else:
        target.write_text("dear")
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(FlockError, match="name another"):
        BagWriter(target / "deeper" if kind == "under a file" else target, TOPICS, {})
    assert sorted(tmp_path.rglob("*")) == before


def test_a_topic_named_twice_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FlockError, match="/clock is given 2 times"):
        BagWriter(tmp_path / "bag", [TOPICS[2], TOPICS[2]], {})
    assert not (tmp_path / "bag").exists()


def test_a_type_that_is_not_installed_is_refused_before_anything_is_written(
    tmp_path: Path,
) -> None:
    with pytest.raises(FlockError, match="nowhere/msg/Nothing is not installed"):
        BagWriter(tmp_path / "bag", [Topic("/x", "nowhere/msg/Nothing")], {})
    assert not (tmp_path / "bag").exists()


@pytest.mark.parametrize(
    ("name", "words"),
    [("LARGEST_CHUNK", "bytes of one recorded step"), ("LARGEST_MESSAGE", "bytes of one message")],
)
def test_a_row_that_readers_would_refuse_is_not_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, words: str
) -> None:
    monkeypatch.setattr(limits, "LARGEST_MESSAGE", 3_000)
    monkeypatch.setattr(limits, name, 3_000)
    row = [(topic.name, 7, bytes(2_900)) for topic in TOPICS[:2]]
    length = 2_900 + 22  # channel, sequence and two times come before the data
    bag = BagWriter(tmp_path / "bag", TOPICS, METADATA)
    bag.write_together(row[:1])
    bag.flush()
    if name == "LARGEST_MESSAGE":
        row[1] = (row[1][0], 7, bytes(2_979))
        length = 2_979 + 22
    size = length if name == "LARGEST_MESSAGE" else 2 * (length + 9)
    bag.write_together(row)
    with pytest.raises(RunFailed, match=rf"get {size} {words}, more than the limit of 3000; fly"):
        bag.flush()
    with pytest.raises(RunFailed, match="more than the limit"):
        bag.write_together(row[:1])
    bag.close()
    with BagReader(tmp_path / "bag") as read:
        assert [len(data) for _, _, data in read.messages()] == [2_900]
