# SPDX-License-Identifier: Apache-2.0
"""Truncated and damaged bags: intact parts are read, and missing parts are reported."""

import os
import random
import struct
from contextlib import suppress
from io import BytesIO
from pathlib import Path

import pytest
from mcap.exceptions import McapError
from mcap.reader import NonSeekingReader, make_reader

from flock_sim.bag.reading.reader import BagReader
from flock_sim.bag.topic import Topic
from flock_sim.bag.writing.writer import BagWriter
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.errors import FlockError
from flock_sim.recording.run import Run
from support.flights import record

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


def read(path: Path) -> tuple[list[Row], str | None]:
    with BagReader(path) as bag:
        return list(bag.messages()), bag.missing


def chunk_ends(path: Path) -> list[int]:
    """For each chunk, where it ends in the file (message indexes apart)."""
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    return [index.chunk_start_offset + index.chunk_length for index in summary.chunk_indexes]


def test_a_file_cut_off_anywhere_in_its_last_chunk_gives_every_whole_chunk(tmp_path: Path) -> None:
    messages = rows(90)
    path = write_bag(tmp_path / "bag", messages)
    (path.parent / "metadata.yaml").unlink()
    whole = path.read_bytes()
    ends = chunk_ends(path)
    summary = range(len(whole) - 1, ends[-1] + 500, -29)
    for size in (*summary, *range(ends[-1] + 500, ends[-2] - 1, -1)):
        os.truncate(path, size)
        found, missing = read(path.parent)
        assert found == messages[: 90 if size >= ends[-1] else 60]
        assert missing is not None
        assert "\n" not in missing
        assert "metadata.yaml" in missing


def test_a_file_cut_off_at_random_gives_every_whole_chunk_or_is_refused(tmp_path: Path) -> None:
    messages = rows(900)
    path = write_bag(tmp_path / "bag", messages)
    ends = chunk_ends(path)
    whole = path.read_bytes()
    chance = random.Random(4)
    for size in sorted((chance.randrange(8, len(whole)) for _ in range(300)), reverse=True):
        os.truncate(path, size)
        found, missing = read(path)
        assert found == messages[: 30 * sum(end <= size for end in ends)]
        assert missing is not None
    for size in range(8):
        os.truncate(path, size)
        with pytest.raises(FlockError, match="empty file" if size == 0 else "not an MCAP file"):
            BagReader(path)


@pytest.mark.slow
def test_two_thousand_truncations_of_a_flight_never_give_what_was_not_recorded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(BagWriter.__init__.__kwdefaults__, "chunk_size", 4096)
    configuration = FlockConfiguration(birds=3, t_max=150.0, record_every=1)
    flight = record(tmp_path / "flight", configuration, grants=True)
    (path,) = flight.glob("*.mcap")
    (flight / "metadata.yaml").unlink()
    recorded, _ = read(flight)
    with path.open("rb") as file:
        chunks = make_reader(file).get_summary().chunk_indexes
    ends = [chunk.chunk_start_offset + chunk.chunk_length for chunk in chunks]
    counts = [sum(1 for _ in read_to(path, end)) for end in ends]
    assert len(ends) > 10
    assert counts[-1] == len(recorded)

    chance = random.Random(8)
    last = range(chunks[-1].chunk_start_offset, ends[-1] + 1)
    sizes = set(last)
    while len(sizes) < 2000:
        sizes.add(chance.randrange(ends[-1] + 2000))
    begin = chunks[0].chunk_start_offset
    data = path.read_bytes()
    for size in sorted(sizes):
        path.write_bytes(data[:size])
        whole = sum(end <= size for end in ends)
        try:
            with Run(flight) as run:
                assert run.missing is not None
                assert "\n" not in run.missing
                found = list(run.bag.messages())
        except FlockError:
            assert size < begin  # the configuration itself is torn
            continue
        assert found == recorded[: counts[whole - 1] if whole else 0]


def read_to(path: Path, size: int) -> list[Row]:
    """Return what the first `size` bytes of a file hold, by another project's reader."""
    with path.open("rb") as file:
        data = BytesIO(file.read(size))
    reader = NonSeekingReader(data)
    found = []
    with suppress(McapError, struct.error):
        for _, channel, message in reader.iter_messages(log_time_order=False):
            found.append((channel.topic, message.log_time, message.data))
    return found


def test_a_torn_bag_still_has_its_configuration(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "bag", rows(60))
    os.truncate(path, chunk_ends(path)[0] - 1)
    with BagReader(path) as bag:
        assert bag.metadata("flock") == {"birds": "3"}
        assert bag.topics == {topic.name: topic.type for topic in TOPICS}
        assert bag.message_counts is None
        assert bag.last_time is None


def test_what_a_power_cut_left_unwritten_is_left_out(tmp_path: Path) -> None:
    messages = rows(120)
    path = write_bag(tmp_path / "bag", messages)
    data = bytearray(path.read_bytes())
    ends = chunk_ends(path)
    for begin, end, chunks in ((ends[2] - 40, len(data), 2), (ends[1] + 3, ends[2] + 9, 2)):
        hole = bytearray(data[: ends[-1]])
        hole[begin : min(end, len(hole))] = bytes(min(end, len(hole)) - begin)
        path.write_bytes(hole)
        found, missing = read(path)
        assert found == messages[: 30 * chunks]
        assert missing is not None
        assert "bytes of data" in missing


def test_flipped_bytes_never_give_a_value_that_was_not_recorded(tmp_path: Path) -> None:
    messages = [row for row in rows(60) if row[0] == TOPICS[0].name]
    path = write_bag(tmp_path / "bag", messages, every=10)
    sound = path.read_bytes()
    recorded = set(messages)
    for position in range(0, len(sound), 3):
        data = bytearray(sound)
        data[position] ^= 0x41
        path.write_bytes(data)
        try:
            with BagReader(path) as bag:
                if set(bag.topics) != {topic.name for topic in TOPICS}:
                    assert bag.missing is not None  # names outside of any CRC, without a summary
                    continue
                found = list(bag.messages())
        except FlockError:
            continue
        assert recorded.issuperset(found)
        assert found == messages or bag.missing is not None


def test_random_bytes_after_the_magic_are_no_crash(tmp_path: Path) -> None:
    chance = random.Random(2)
    path = tmp_path / "x.mcap"
    for _ in range(300):
        size = chance.randrange(200)
        middle = bytes(chance.choice((0, 1, 2, 3, 4, 5, 6, 7, 8, 255)) for _ in range(size))
        end = b"\x89MCAP0\r\n" if chance.random() < 0.5 else b""
        path.write_bytes(b"\x89MCAP0\r\n" + middle + end)
        with BagReader(path) as bag:
            assert list(bag.messages()) == []


def test_a_bag_without_metadata_yaml_is_read_and_told(tmp_path: Path) -> None:
    messages = rows(60)
    path = write_bag(tmp_path / "bag", messages)
    (path.parent / "metadata.yaml").unlink()
    found, missing = read(path.parent)
    assert found == messages
    assert (
        missing == f"{path.parent} is not complete: no metadata.yaml (the recording was cut short)"
    )


def test_a_damaged_chunk_is_told_when_it_is_read(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "bag", rows(90))
    data = bytearray(path.read_bytes())
    data[chunk_ends(path)[1] - 5] ^= 1
    path.write_bytes(data)
    with BagReader(path) as bag:
        stream = bag.messages()
        for _ in range(30):
            next(stream)
        with pytest.raises(FlockError, match=r"bag_0.mcap is damaged at byte \d+"):
            next(stream)
