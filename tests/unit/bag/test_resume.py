# SPDX-License-Identifier: Apache-2.0
"""An unfinished bag in any state can be resumed, and ends as if flown without interruption."""

import os
import random
import shutil
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap.records import Message, Metadata
from mcap.stream_reader import StreamReader
from rosbags.highlevel import AnyReader

from flock_sim.bag import limits
from flock_sim.bag.topic import Topic
from flock_sim.bag.writing.partial_bag import PartialBag
from flock_sim.bag.writing.writer import BagWriter
from flock_sim.errors import FlockError, RunFailed

TOPICS = [
    Topic("/clock", "rosgraph_msgs/msg/Clock"),
    Topic("/flock/bird_01/state", "std_msgs/msg/Header"),
    Topic("/flock/bird_02/state", "std_msgs/msg/Header"),
]
METADATA = {"flock": {"birds": "2"}}
Sent = tuple[int, int, bytes]


def messages(count: int, first: int = 0) -> list[Sent]:
    """Place of the topic, log time and data; the third topic comes in half of the chunks only."""
    return [
        (i % (3 if i // 20 % 2 else 2), 10 * i, b"%d " % i + bytes(range(i % 40)))
        for i in range(first, first + count)
    ]


def writer(directory: Path, *, resume: bool = False) -> BagWriter:
    return BagWriter(directory, TOPICS, METADATA, resume=resume)


def write(bag: BagWriter, sent: list[Sent]) -> None:
    """Write with a chunk for every 20 messages."""
    for number, (topic, time, data) in enumerate(sent, start=1):
        bag.write(topic, time, data)
        if number % 20 == 0:
            bag.flush()


def assert_complete_with(directory: Path, expected: list[Sent]) -> None:
    """Have mcap's readers, by the index and from front to back, and rosbags find `expected`."""
    (path,) = directory.glob("*.mcap")
    assert {entry.name for entry in directory.iterdir()} == {path.name, "metadata.yaml"}
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        found = [
            (channel.id - 1, message.log_time, message.data)
            for _, channel, message in reader.iter_messages(log_time_order=False)
        ]
        assert found == expected
        counts = summary.statistics.channel_message_counts
        assert counts == {
            channel: number
            for channel in (1, 2, 3)
            if (number := sum(topic == channel - 1 for topic, _, _ in expected))
        }
        assert summary.statistics.message_count == len(expected)
        assert summary.statistics.chunk_count == len(summary.chunk_indexes)
        if expected:
            assert summary.statistics.message_start_time == min(time for _, time, _ in expected)
            assert summary.statistics.message_end_time == max(time for _, time, _ in expected)
        for place, topic in enumerate(TOPICS):  # by the message indexes
            only = [m.data for _, _, m in reader.iter_messages(topics=[topic.name])]
            assert only == [data for at, _, data in expected if at == place]
    with path.open("rb") as file:  # checks the CRC of the whole data section
        records = list(StreamReader(file, validate_crcs=True).records)
    assert sum(isinstance(record, Message) for record in records) == len(expected)
    with AnyReader([directory]) as other:
        assert other.message_count == len(expected)
        assert [data for _, _, data in other.messages()] == [data for _, _, data in expected]


def head_and_extents(path: Path) -> tuple[int, list[tuple[int, int]]]:
    """Where the first chunk begins, and for each where it and its message indexes end."""
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    ends = [(c.chunk_start_offset + c.chunk_length, c) for c in summary.chunk_indexes]
    return summary.chunk_indexes[0].chunk_start_offset, [
        (end, end + chunk.message_index_length) for end, chunk in ends
    ]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A complete bag of 5 chunks, 20 messages each."""
    directory = tmp_path_factory.mktemp("whole") / "bag"
    with writer(directory) as bag:
        write(bag, messages(100))
    assert_complete_with(directory, messages(100))
    return directory


def cut_copy(whole: Path, to: Path, size: int) -> Path:
    """Return a copy of the first `size` bytes of a bag, as a kill leaves it."""
    to.mkdir()
    (to / "bag_0.mcap").write_bytes((whole / "bag_0.mcap").read_bytes()[:size])
    (to / ".reserve").write_bytes(bytes(100))
    return to


@pytest.mark.slow
def test_wherever_a_bag_is_cut_off_it_is_gone_on_with_behind_its_last_whole_chunk(
    tmp_path: Path, whole: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "fsync", lambda fd: None)  # hundreds of bags that no power cut meets
    head, extents = head_and_extents(whole / "bag_0.mcap")
    size = (whole / "bag_0.mcap").stat().st_size
    chance = random.Random(1)
    sizes = {*range(extents[-2][1] - 3, extents[-1][1] + 30), *range(0, head, 97), head, size}
    sizes |= {end + more for pair in extents for end in pair for more in (-1, 0, 1)}
    sizes |= {chance.randrange(size) for _ in range(100)}
    results: dict[int, dict[str, bytes]] = {}
    for cut in sorted(sizes):
        directory = cut_copy(whole, tmp_path / "cut", cut)
        kept = 20 * sum(end <= cut for _, end in extents)
        bag = writer(directory, resume=True)
        assert bag.messages_safe == kept
        assert (bag.begun is not None and bag.begun.has_head) == (cut >= head)
        write(bag, messages(120 - kept, first=kept))
        bag.close()
        # What was kept decides every byte of the rest, so outsiders need judge one of each only.
        result = {entry.name: entry.read_bytes() for entry in directory.iterdir()}
        if results.setdefault(kept, result) is result:
            assert_complete_with(directory, messages(120))
        assert result == results[kept]
        shutil.rmtree(directory)
    assert sorted(results) == [0, 20, 40, 60, 80, 100]


def test_a_closed_bag_is_gone_on_with_and_again(tmp_path: Path) -> None:
    directory = tmp_path / "bag"
    for part in range(4):
        with writer(directory, resume=True) as bag:
            assert bag.messages_safe == 50 * part
            assert not (directory / "metadata.yaml").exists()
            write(bag, messages(50, first=50 * part))
        assert_complete_with(directory, messages(50 * part + 50))


def noted(path: Path) -> dict[str, dict[str, str]]:
    """Return the metadata records of a complete bag, read by mcap's index and from its front."""
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        found = {record.name: record.metadata for record in reader.iter_metadata()}
        records = StreamReader(path.open("rb"), validate_crcs=True).records
        assert found == {r.name: r.metadata for r in records if isinstance(r, Metadata)}
    return found


@pytest.mark.slow
def test_metadata_between_chunks_is_kept_and_that_at_the_end_is_dropped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "fsync", lambda fd: None)
    with writer(tmp_path / "whole") as bag:
        bag.add_metadata("first", {"machine": "a"})
        write(bag, messages(40))
        bag.add_metadata("second", {"machine": "b"})
        write(bag, messages(20, first=40))
        bag.add_metadata("third", {})
        bag.close({"last": {"digest": "x"}})
    path = tmp_path / "whole" / "bag_0.mcap"
    (tmp_path / "whole" / "whole_0.mcap").rename(path)
    always = {**METADATA, "first": {"machine": "a"}, "second": {"machine": "b"}}
    assert noted(path) == {**always, "third": {}, "last": {"digest": "x"}}
    first, extents = head_and_extents(path)
    ends = [end for _, end in extents]
    size = path.stat().st_size
    cuts = {*range(first - 60, first + 3), *range(ends[1] - 1, ends[1] + 60)}  # in the records
    cuts |= {ends[0], *range(ends[2] - 1, size, 13), size}
    for cut in sorted(cuts):
        directory = cut_copy(tmp_path / "whole", tmp_path / "cut", cut)
        kept = sum(end <= cut for end in ends)
        with writer(directory, resume=True) as bag:
            assert list(bag.metadata) == [[], ["first"], ["first"], ["first", "second"]][kept]
            for name, values in (("first", {"machine": "a"}), ("second", {"machine": "b"})):
                if name not in bag.metadata:
                    bag.add_metadata(name, values)
            write(bag, messages(60 - 20 * kept, first=20 * kept))
        assert_complete_with(directory, messages(60))
        assert noted(directory / "bag_0.mcap") == always
        shutil.rmtree(directory)


def test_damage_behind_metadata_is_still_found(tmp_path: Path) -> None:
    directory = tmp_path / "bag"
    with writer(directory) as bag:
        write(bag, messages(20))
        bag.add_metadata("note", {"by": "us"})
        write(bag, messages(40, first=20))
    path = directory / "bag_0.mcap"
    data = bytearray(path.read_bytes())
    _, extents = head_and_extents(path)
    data[extents[1][0] - 5] ^= 1  # within a chunk
    path.write_bytes(data)
    with writer(directory, resume=True) as bag:
        assert (bag.messages_safe, list(bag.metadata)) == (20, [])
        assert bag.aside is not None
        assert bag.aside.read_bytes() == data


def test_a_bag_in_several_parts_equals_one_written_in_one_go(tmp_path: Path, whole: Path) -> None:
    directory = tmp_path / "bag"
    for part in range(5):  # a chunk each, as in `whole`
        with writer(directory, resume=True) as bag:
            write(bag, messages(20, first=20 * part))
    for name in ("bag_0.mcap", "metadata.yaml"):
        assert (directory / name).read_bytes() == (whole / name).read_bytes()


def test_to_go_on_with_nothing_changes_nothing(tmp_path: Path, whole: Path) -> None:
    size = (whole / "bag_0.mcap").stat().st_size
    directory = cut_copy(whole, tmp_path / "bag", size)
    writer(directory, resume=True).close()
    for name in ("bag_0.mcap", "metadata.yaml"):
        assert (directory / name).read_bytes() == (whole / name).read_bytes()


def test_the_part_of_a_metadata_file_is_removed(tmp_path: Path, whole: Path) -> None:
    size = (whole / "bag_0.mcap").stat().st_size
    directory = cut_copy(whole, tmp_path / "bag", size)
    (directory / "metadata.yaml.part").write_text("rosbag2_")
    writer(directory, resume=True).leave()
    assert {entry.name for entry in directory.iterdir()} == {"bag_0.mcap"}


def test_a_bag_that_was_left_is_gone_on_with(tmp_path: Path) -> None:
    bag = writer(tmp_path / "bag")
    write(bag, messages(30))
    bag.leave()
    bag.leave()
    bag.close()  # it stays as it was left
    with pytest.raises(RunFailed, match="closed"):
        bag.write(0, 1, b"")
    assert {entry.name for entry in (tmp_path / "bag").iterdir()} == {"bag_0.mcap"}
    with writer(tmp_path / "bag", resume=True) as again:
        assert again.messages_safe == 30
        write(again, messages(10, first=30))
    assert_complete_with(tmp_path / "bag", messages(40))


@pytest.mark.parametrize("there", ["nothing", "directory"])
def test_where_there_is_no_bag_one_is_begun(tmp_path: Path, there: str) -> None:
    directory = tmp_path / "deep" / "bag"
    if there == "directory":
        directory.mkdir(parents=True)
    with writer(directory, resume=True) as bag:
        assert bag.begun is None
        write(bag, messages(20))
    assert_complete_with(directory, messages(20))


def test_a_bag_whose_directory_was_renamed_is_gone_on_with(tmp_path: Path, whole: Path) -> None:
    directory = cut_copy(whole, tmp_path / "renamed", head_and_extents(whole / "bag_0.mcap")[0])
    with writer(directory, resume=True) as bag:
        write(bag, messages(20))
    assert_complete_with(directory, messages(20))


def test_what_a_power_cut_left_unwritten_is_cut_off(tmp_path: Path, whole: Path) -> None:
    _, extents = head_and_extents(whole / "bag_0.mcap")
    data = bytearray((whole / "bag_0.mcap").read_bytes()[: extents[-1][1]])
    holes = (
        (extents[2][1] + 60, extents[3][0] - 5, 3),  # within chunk 4 of 5, and all of chunk 5
        (extents[3][0] - 5, extents[3][0] + 5, 3),
        (extents[3][1] + 1, extents[3][1] + 40, 4),
    )
    for number, (begin, end, chunks) in enumerate(holes):
        directory = cut_copy(whole, tmp_path / f"hole{number}", 0)
        hole = bytearray(data)
        hole[begin:end] = bytes(end - begin)
        if chunks == 3:
            hole[extents[3][1] + 50 :] = bytes(len(hole) - extents[3][1] - 50)
        (directory / "bag_0.mcap").write_bytes(hole)
        with writer(directory, resume=True) as bag:
            assert bag.messages_safe == 20 * chunks
        assert_complete_with(directory, messages(20 * chunks))


def test_any_flipped_byte_of_the_last_chunk_costs_that_chunk(tmp_path: Path, whole: Path) -> None:
    head, extents = head_and_extents(whole / "bag_0.mcap")
    sound = (whole / "bag_0.mcap").read_bytes()[: extents[-1][1]]
    path = tmp_path / "bag_0.mcap"
    for position in range(extents[-2][1], len(sound)):
        data = bytearray(sound)
        data[position] ^= 0x41
        path.write_bytes(data)
        with path.open("rb") as file:
            begun = PartialBag(file.fileno(), path, sound[:head])
            assert begun.keep(len(begun.chunks)).written.messages == 80
            assert begun.keep(len(begun.chunks)).size == extents[-2][1]


def test_a_bag_is_cut_back_to_its_first_chunks(tmp_path: Path, whole: Path) -> None:
    for chunks in range(6):
        size = (whole / "bag_0.mcap").stat().st_size
        directory = cut_copy(whole, tmp_path / f"bag{chunks}", size)
        with writer(directory, resume=True) as bag:
            assert bag.begun is not None
            read = [message for number in range(chunks) for message in bag.begun.messages(number)]
            assert read == messages(20 * chunks)
            bag.cut_back(chunks)
            write(bag, messages(20, first=500))
        assert_complete_with(directory, messages(20 * chunks) + messages(20, first=500))


@pytest.mark.parametrize("other", ["metadata", "topics", "order", "type", "no bag at all"])
def test_a_bag_that_was_begun_with_something_else_is_refused_and_left_alone(
    tmp_path: Path, whole: Path, other: str
) -> None:
    directory = tmp_path / "bag"
    directory.mkdir()
    for entry in whole.iterdir():
        (directory / entry.name).write_bytes(entry.read_bytes())
    if other == "no bag at all":
        (directory / "bag_0.mcap").write_bytes(b"\x89MCAP0\r\nthesis")
    before = {entry.name: entry.read_bytes() for entry in directory.iterdir()}
    topics = {
        "topics": TOPICS[:2],
        "order": TOPICS[::-1],
        "type": [Topic("/clock", "std_msgs/msg/Header"), *TOPICS[1:]],
    }.get(other, TOPICS)
    metadata = {"flock": {"birds": "3"}} if other == "metadata" else METADATA
    with pytest.raises(FlockError, match=r"bag_0.mcap can't be continued: .* or name") as told:
        BagWriter(directory, topics, metadata, resume=True)
    assert "\n" not in str(told.value)
    assert told.value.exit_status == 2
    assert {entry.name: entry.read_bytes() for entry in directory.iterdir()} == before


def test_a_directory_that_holds_something_else_is_refused(tmp_path: Path, whole: Path) -> None:
    (tmp_path / "thesis.tex").write_text("dear")
    with pytest.raises(FlockError, match="not empty: name another"):
        writer(tmp_path, resume=True)
    for name in ("bag_0.mcap", "bag_1.mcap"):
        (tmp_path / name).write_bytes((whole / "bag_0.mcap").read_bytes())
    with pytest.raises(FlockError, match=r"2 \.mcap files"):
        writer(tmp_path, resume=True)
    with pytest.raises(FlockError, match=r"can't be read \(Not a directory\)"):
        writer(tmp_path / "thesis.tex", resume=True)


def test_a_bag_that_is_being_written_is_refused(tmp_path: Path) -> None:
    with writer(tmp_path / "bag") as bag:
        write(bag, messages(20))
        with pytest.raises(FlockError, match="another process is writing to it"):
            writer(tmp_path / "bag", resume=True)
        write(bag, messages(20, first=20))
    assert_complete_with(tmp_path / "bag", messages(40))


def test_messages_that_belong_together_are_in_one_chunk_or_none_is_there(tmp_path: Path) -> None:
    def interrupted() -> object:
        yield from messages(7, first=40)
        raise KeyboardInterrupt

    with BagWriter(tmp_path / "bag", TOPICS, METADATA, chunk_size=64) as bag:
        for first in (0, 20):  # far above the limit of a chunk
            bag.write_together(messages(20, first))
            assert bag.messages_safe == first + 20
        with pytest.raises(KeyboardInterrupt):
            bag.write_together(interrupted())
        bag.write(0, 400, b"x")
        with pytest.raises(KeyboardInterrupt):
            bag.write_together(interrupted())
    assert_complete_with(tmp_path / "bag", [*messages(40), (0, 400, b"x")])


@pytest.mark.parametrize("after", [False, True])
def test_a_ctrl_c_while_a_chunk_is_written_spoils_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, after: bool
) -> None:
    def interrupted(fd: int, data: memoryview, offset: int) -> int:
        monkeypatch.setattr(os, "pwrite", pwrite)
        if after:
            pwrite(fd, data, offset)
        raise KeyboardInterrupt

    pwrite = os.pwrite
    with writer(tmp_path / "bag") as bag:
        write(bag, messages(40))
        monkeypatch.setattr(os, "pwrite", interrupted)
        with pytest.raises(KeyboardInterrupt):
            write(bag, messages(20, first=40))
    assert_complete_with(tmp_path / "bag", messages(40))


def test_a_bag_that_unpacks_to_too_much_is_not_continued(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bag = writer(tmp_path / "run")
    write(bag, messages(100))
    bag.leave()
    monkeypatch.setattr(limits, "CHUNKS_RATIO", 0)
    monkeypatch.setattr(limits, "CHUNKS_SIZE", 1000)
    with pytest.raises(
        FlockError,
        match=r"\.mcap has \d+ unpacked bytes in its chunks, more than the limit of 1000",
    ):
        writer(tmp_path / "run", resume=True)
