# SPDX-License-Identifier: Apache-2.0
"""Hostile bags: what they state takes neither memory nor time without bound, and is one error."""

from __future__ import annotations

import os
import struct
import subprocess
import sys
import tracemalloc
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import islice
from pathlib import Path

import lz4.frame  # type: ignore[import-untyped]
import pytest
import zstandard
from mcap.opcode import Opcode
from mcap.records import Channel, Metadata, MetadataIndex, Schema, Statistics

from flock_sim.bag import index, limits
from flock_sim.bag.file_sections import MAGIC, pack
from flock_sim.bag.reading.compression import unpacked_message
from flock_sim.bag.reading.listing import listing
from flock_sim.bag.reading.reader import BagReader, Stream
from flock_sim.bag.records import FRAME, MESSAGE, DamagedError
from flock_sim.errors import FlockError
from support.foreign import word, write_bag, write_metadata
from support.foreign_play import words

MIB, GIB = 2**20, 2**30
WORDS = Stream("/words", "", "cdr")
CHANNEL = Channel(id=1, topic="/words", message_encoding="cdr", metadata={}, schema_id=0)
HUGE = [2**62, 2**63 - 50, 2**63 - 1, 2**63, 2**64 - 1]


def message(time: int, size: int = 0) -> bytes:
    """Return the record of a message."""
    return MESSAGE.pack(Opcode.MESSAGE, MESSAGE.size - FRAME.size + size, 1, 0, time, time) + bytes(
        size
    )


def chunk(
    body: bytes, *, compression: str = "", size: int | None = None, start: int = 0, end: int = 0
) -> bytes:
    """Return the record of a chunk that holds `body`, packed, and states `size` unpacked bytes."""
    name = compression.encode()
    head = struct.pack("<QQQII", start, end, len(body) if size is None else size, 0, len(name))
    content = head + name + struct.pack("<Q", len(body)) + body
    return FRAME.pack(Opcode.CHUNK, len(content)) + content


def chunk_index(offset: int, length: int, start: int = 0, end: int = 0) -> bytes:
    """Return the index of a chunk without channels."""
    content = struct.pack("<QQQQI", start, end, offset, length, 0)
    content += struct.pack("<QI", 0, 0) + struct.pack("<QQ", 0, 0)
    return FRAME.pack(Opcode.CHUNK_INDEX, len(content)) + content


def write(path: Path, data: bytes, summary: bytes | None = None, start: int | None = None) -> Path:
    """Write a file; `summary` None: it has none. `start` is where it claims to begin."""
    content = MAGIC + data + FRAME.pack(Opcode.DATA_END, 4) + bytes(4)
    begin = len(content) if start is None else start
    content += summary or b""
    footer = struct.pack("<QQI", 0 if summary is None else begin, 0, 0)
    path.write_bytes(content + FRAME.pack(Opcode.FOOTER, len(footer)) + footer + MAGIC)
    return path


def statistics(chunks: int, records: int = 0) -> bytes:
    """Return the record of the statistics of a file with one channel."""
    return pack(
        Statistics(
            attachment_count=0,
            channel_count=1,
            channel_message_counts={1: 1},
            chunk_count=chunks,
            message_count=1,
            message_start_time=0,
            message_end_time=0,
            metadata_count=records,
            schema_count=0,
        )
    )


def times(path: Path) -> list[int]:
    with BagReader(path) as bag:
        return [time for _, time, _ in bag.messages()]


@contextmanager
def little_memory(most: int) -> Iterator[None]:
    """Assert that the block does not use more than `most` bytes at a time."""
    tracemalloc.start()
    try:
        yield
        assert tracemalloc.get_traced_memory()[1] < most
    finally:
        tracemalloc.stop()


def read_apart(path: Path) -> str:
    """Return the error of opening `path`, in a process that may not hang."""
    script = (
        "import sys\nfrom flock_sim.bag.reading.reader import BagReader\n"
        "from flock_sim.errors import FlockError\n"
        "try:\n    print(BagReader(sys.argv[1]).missing)\nexcept FlockError as error:\n"
        "    print(error)"
    )
    done = subprocess.run(
        [sys.executable, "-c", script, path],
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.parametrize("offset", HUGE)
@pytest.mark.parametrize("length", [40, *HUGE])
def test_a_chunk_beyond_every_file_is_damage(tmp_path: Path, offset: int, length: int) -> None:
    summary = pack(CHANNEL) + statistics(1) + chunk_index(offset, length)
    path = write(tmp_path / "a.mcap", pack(CHANNEL) + chunk(message(7)), summary)
    with pytest.raises(FlockError, match="damaged at byte") as caught:
        times(path)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize("offset", HUGE)
def test_metadata_beyond_every_file_is_a_damaged_summary(tmp_path: Path, offset: int) -> None:
    summary = pack(CHANNEL, MetadataIndex(offset, 20, "a")) + statistics(0, 1)
    path = write(tmp_path / "a.mcap", pack(CHANNEL) + chunk(message(7)), summary)
    assert times(path) == [7]


@pytest.mark.parametrize("start", HUGE)
def test_a_summary_beyond_every_file_is_damaged(tmp_path: Path, start: int) -> None:
    path = write(tmp_path / "a.mcap", pack(CHANNEL) + chunk(message(7)), b"", start)
    assert times(path) == [7]


@pytest.mark.parametrize("compression", ["", "zstd", "lz4"])
@pytest.mark.parametrize("size", [10 * GIB, *HUGE])
def test_the_stated_size_of_a_chunk_is_limited(tmp_path: Path, compression: str, size: int) -> None:
    packed = {"": bytes, "zstd": zstandard.compress, "lz4": lz4.frame.compress}[compression]
    bomb = chunk(packed(message(7)), compression=compression, size=size)
    summary = pack(CHANNEL) + statistics(1) + chunk_index(len(MAGIC), len(bomb))
    path = write(tmp_path / "a.mcap", bomb, summary)
    with pytest.raises(FlockError) as caught:
        times(path)
    assert str(caught.value).startswith(
        f"{path} is damaged at byte 8 (it has {size} unpacked bytes,"
        f" more than the limit of {limits.LARGEST_CHUNK})"
    )


@pytest.mark.parametrize("sized", [True, False])
@pytest.mark.parametrize("compression", ["zstd", "lz4"])
def test_a_chunk_that_unpacks_to_more_than_it_states_takes_no_memory(
    tmp_path: Path, compression: str, sized: bool
) -> None:
    if compression == "zstd":
        packed = zstandard.ZstdCompressor(write_content_size=sized).compress(bytes(64 * MIB))
    else:
        packed = lz4.frame.compress(bytes(64 * MIB), store_size=sized)
    bomb = chunk(packed, compression=compression, size=MIB)
    summary = pack(CHANNEL) + statistics(1) + chunk_index(len(MAGIC), len(bomb))
    path = write(tmp_path / "a.mcap", bomb, summary)
    with little_memory(16 * MIB), pytest.raises(FlockError, match="damaged at byte 8"):
        times(path)


def test_a_cut_lz4_frame_is_damage(tmp_path: Path) -> None:
    packed = lz4.frame.compress(message(7))[:-4]
    bomb = chunk(packed, compression="lz4", size=len(message(7)))
    summary = pack(CHANNEL) + statistics(1) + chunk_index(len(MAGIC), len(bomb))
    with pytest.raises(FlockError, match="its end is missing"):
        times(write(tmp_path / "a.mcap", bomb, summary))


@pytest.mark.parametrize("sized", [True, False])
def test_the_unpacked_size_of_a_message_is_limited(
    monkeypatch: pytest.MonkeyPatch, sized: bool
) -> None:
    monkeypatch.setattr(limits, "LARGEST_MESSAGE", 2 * MIB)
    compressor = zstandard.ZstdCompressor(write_content_size=sized)
    assert unpacked_message(compressor.compress(bytes(2 * MIB))) == bytes(2 * MIB)
    bomb = compressor.compress(bytes(64 * MIB))
    with (
        little_memory(8 * MIB),
        pytest.raises(DamagedError, match="more than the limit of 2097152"),
    ):
        unpacked_message(bomb)


def test_the_unpacked_size_of_a_file_is_limited(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(limits, "UNPACKED_SIZE", MIB)
    monkeypatch.setattr(limits, "UNPACKED_RATIO", 10)
    path = tmp_path / "a.mcap.zstd"
    path.write_bytes(zstandard.compress(MAGIC + bytes(64 * MIB)))
    with pytest.raises(FlockError, match=f"{path} unpacks to .*, more than the limit of {MIB}"):
        BagReader(path)
    sound = write_bag(tmp_path / "bag", words(1, 2), mode="FILE")
    monkeypatch.setattr(limits, "UNPACKED_SIZE", 1)
    assert len(times(sound)) == 2


def test_chunks_that_overlap_in_the_index_are_read_once(tmp_path: Path) -> None:
    one = chunk(message(7))
    summary = pack(CHANNEL) + statistics(1000)
    summary += chunk_index(len(MAGIC) + len(pack(CHANNEL)), len(one)) * 1000
    path = write(tmp_path / "a.mcap", pack(CHANNEL) + one, summary)
    assert times(path) == [7]
    with BagReader(path) as bag:
        assert "begins within another one" in str(bag.missing)


def test_equal_copies_of_definitions_are_parsed_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Writers repeat them in each chunk, so they do not count as more definitions.
    parsed: list[object] = []
    parse = index.parse
    monkeypatch.setattr(index, "parse", lambda *args: parsed.append(1) or parse(*args))
    monkeypatch.setattr(limits, "MOST_DEFINITIONS", 10)
    schema = Schema(id=1, data=b"string data\n", encoding="ros2msg", name="std_msgs/msg/String")
    inner = (pack(schema) + pack(CHANNEL)) * 1000
    path = write(tmp_path / "a.mcap", inner + chunk(inner + message(7)) * 3)
    assert times(path) == [7, 7, 7]
    assert len(parsed) < 20


@pytest.mark.parametrize("kind", ["channel", "schema", "metadata"])
def test_the_number_of_definitions_is_limited(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    monkeypatch.setattr(limits, "MOST_DEFINITIONS", 1000)

    def record(number: int) -> bytes:
        if kind == "channel":
            return pack(Channel(number, f"/a{number}", "cdr", {}, 0))
        if kind == "schema":
            return pack(Schema(id=number, data=b"", encoding="", name=str(number)))
        return pack(Metadata(name=str(number), metadata={}))

    path = write(tmp_path / "a.mcap", b"".join(map(record, range(1, 1002))))
    with pytest.raises(FlockError) as caught:
        BagReader(path)
    assert str(caught.value).startswith(
        f"{path} has 1001 definitions, more than the limit of 1000:"
    )


def test_the_size_of_definitions_is_limited(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(limits, "LARGEST_DEFINITION", 10_000)
    large = pack(Schema(id=1, data=bytes(20_000), encoding="", name="a"))
    with pytest.raises(FlockError, match="bytes in one definition, more than the limit of 10000"):
        BagReader(write(tmp_path / "a.mcap", large))
    monkeypatch.setattr(limits, "DEFINITIONS_SIZE", 50_000)
    record = pack(Metadata(name="a", metadata={"key": "x" * 5000}))
    # The index may name one record again and again.
    entries = pack(MetadataIndex(len(MAGIC), len(record), "a")) * 20
    path = write(tmp_path / "a.mcap", record, entries + statistics(0, 20))
    with pytest.raises(FlockError, match="metadata, more than the limit of 50000"):
        BagReader(path)


@pytest.mark.parametrize("indexed", [True, False])
def test_the_number_of_chunks_is_limited(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, indexed: bool
) -> None:
    monkeypatch.setattr(limits, "MOST_CHUNKS", 100)
    summary = b"".join(chunk_index(100 * at, 100) for at in range(101)) if indexed else None
    path = write(tmp_path / "a.mcap", chunk(message(7)) * 101, summary)
    with pytest.raises(FlockError, match=r"a\.mcap has 101 chunks, more than the limit of 100"):
        BagReader(path)


def test_a_large_summary_is_not_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(limits, "LARGEST_SUMMARY", 1000)
    summary = pack(CHANNEL) + statistics(0) + FRAME.pack(0x80, 2000) + bytes(2000)
    path = write(tmp_path / "a.mcap", pack(CHANNEL) + chunk(message(7)), summary)
    assert times(path) == [7]
    with BagReader(path) as bag:
        assert "bytes, more than the limit of 1000" in str(bag.missing)


def test_unlike_sets_of_channels_are_remembered_to_a_limit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sets = index._ChannelSets()
    sets._room = 3
    first, second = struct.pack("<HQHQ", 1, 0, 2, 0), struct.pack("<HQHQ", 3, 0, 4, 0)
    assert sets.of(first) == {1, 2}
    assert sets.of(second) == set()  # unknown, so such a chunk is read
    assert sets.of(first) == {1, 2}


@pytest.mark.parametrize("read", ["by_time", "latest"])
def test_messages_that_overlap_in_time_are_kept_to_a_limit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, read: str
) -> None:
    # Each chunk claims to have early and late messages, so that none can be left.
    late = 2**64 - 1
    chunks = b"".join(chunk(message(time, 10_000), end=late) for time in range(100))
    path = write(tmp_path / "a.mcap", pack(CHANNEL) + chunks)
    with BagReader(path) as bag:
        reads: dict[str, Callable[[], object]] = {
            "by_time": lambda: [time for _, time, _ in bag.by_time([WORDS])],
            "latest": lambda: [time for _, time, _ in bag.latest({WORDS: 100}, late)],
        }
        assert reads[read]() == list(range(100))
        monkeypatch.setattr(limits, "OVERLAP", 500_000)
        assert [time for _, time, _ in bag.latest({WORDS: 3}, late)] == [97, 98, 99]
        with pytest.raises(FlockError, match=r"a\.mcap has .* more than the limit of 500000"):
            reads[read]()


def test_the_search_behind_damage_is_limited(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Each of these heads claims the rest of the file as its data: a search that unpacks the rest
    # for each of them takes a time that grows with the square of the size.
    count, head = 500, chunk(b"", compression="zstd", size=MIB)
    data = b""
    for _ in range(count):
        content = bytearray(head + data)
        struct.pack_into("<Q", content, 1, len(content) - FRAME.size)
        struct.pack_into("<Q", content, len(head) - 8, len(data))
        data = bytes(content)
    path = write(tmp_path / "a.mcap", data + chunk(message(7)), None)
    monkeypatch.setattr(limits, "SEARCHED_SIZE", 100 * MIB)
    monkeypatch.setattr(limits, "SEARCHED_RATIO", 1)
    with (
        BagReader(path) as bag,
        pytest.raises(FlockError, match="damaged chunks that overlap, more than the limit of 1048"),
    ):
        list(bag.salvage([]))


def test_a_whole_chunk_with_a_damaged_message_is_salvaged_up_to_it(tmp_path: Path) -> None:
    body = message(7) + FRAME.pack(Opcode.MESSAGE, 3) + bytes(3)
    path = write(tmp_path / "a.mcap", pack(CHANNEL) + chunk(body) + chunk(message(8)))
    broken: list[str] = []
    with BagReader(path) as bag:
        assert [time for _, time, _ in bag.salvage(broken)] == [7, 8]
    assert broken == [f"{path} is damaged at byte {len(MAGIC) + len(pack(CHANNEL))}"]


@pytest.mark.parametrize("path", ["/dev/zero", "/dev/random", "/dev/null", "/dev/tty"])
def test_a_device_is_no_bag(path: str) -> None:
    assert read_apart(Path(path)).startswith(f"{path} ")


def test_a_pipe_is_no_bag_nor_a_part_of_one(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe.mcap"
    os.mkfifo(pipe)
    assert read_apart(pipe) == f"{pipe} can't be read: is a named pipe, which has no end\n"
    assert "is a named pipe" in read_apart(tmp_path)
    sound = write_bag(tmp_path / "bag", words(1))
    (sound / "metadata.yaml").unlink()
    os.mkfifo(sound / "metadata.yaml")
    assert "metadata.yaml can't be read" in read_apart(sound)


def test_a_directory_with_too_many_bags_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(limits, "MOST_FILES", 10)
    for number in range(11):
        (tmp_path / f"{number}.mcap").touch()
    with pytest.raises(FlockError, match="has 11 files of bags, more than the limit of 10:"):
        listing(tmp_path)


def test_a_large_metadata_file_is_not_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sound = write_bag(tmp_path / "bag", words(1))
    monkeypatch.setattr(limits, "LARGEST_METADATA_FILE", 100)
    with BagReader(sound) as bag:
        assert "metadata.yaml has more than 100 bytes, the limit" in str(bag.missing)
        assert len(list(bag.messages())) == 1


def test_names_in_metadata_are_listed_to_a_limit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sound = write_bag(tmp_path / "bag", words(1))
    write_metadata(sound, ["bag_0.mcap", *(f"{number}.mcap" for number in range(5000))])
    monkeypatch.setattr(limits, "MOST_FILES", 1000)
    with BagReader(sound) as bag:
        assert "metadata.yaml lists 5001 files, more than the limit of 1000" in str(bag.missing)


def test_compressed_messages_that_are_kept_are_limited_unpacked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    said = [(each, time, word("x" * 100_000)) for each, time, _ in words(*range(100))]
    sound = write_bag(tmp_path / "bag", said, mode="MESSAGE")
    monkeypatch.setattr(limits, "OVERLAP", MIB)
    with BagReader(sound) as bag:
        assert len(list(islice(bag.by_time(bag.streams), 100))) == 100
        with pytest.raises(FlockError, match="more than the limit of 1048576"):
            bag.latest(dict.fromkeys(bag.streams, 100), 2**64)


READS: dict[str, Callable[[BagReader], object]] = {
    "messages": lambda bag: list(bag.messages()),
    "by_time": lambda bag: list(bag.by_time([WORDS])),
    "latest": lambda bag: bag.latest({WORDS: 1000}, 2**64),
    "salvage": lambda bag: list(bag.salvage([])),
}


@pytest.mark.parametrize("read", READS)
def test_what_all_chunks_unpack_to_is_limited_in_each_pass(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, read: str
) -> None:
    packed, count = zstandard.compress(message(7, 10_000)), 40
    one = chunk(packed, compression="zstd", size=len(message(7, 10_000)))
    summary = pack(CHANNEL) + statistics(count)
    first = len(MAGIC) + len(pack(CHANNEL))
    summary += b"".join(chunk_index(first + k * len(one), len(one)) for k in range(count))
    path = write(tmp_path / "a.mcap", pack(CHANNEL) + one * count, summary)
    monkeypatch.setattr(limits, "CHUNKS_RATIO", 1)
    monkeypatch.setattr(limits, "CHUNKS_SIZE", 500_000)
    with BagReader(path) as bag:
        for _ in range(3):  # the limit is for each pass
            READS[read](bag)
        monkeypatch.setattr(limits, "CHUNKS_SIZE", 300_000)
        with pytest.raises(
            FlockError,
            match=r"a\.mcap has \d+ unpacked bytes in its chunks, more than the limit of 300000: ",
        ):
            READS[read](bag)
        monkeypatch.setattr(limits, "CHUNKS_RATIO", 1000)  # a larger file may unpack to more
        READS[read](bag)


def test_the_size_of_a_message_in_a_chunk_is_limited(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write(tmp_path / "a.mcap", pack(CHANNEL) + chunk(message(7, 2000)))
    monkeypatch.setattr(limits, "LARGEST_MESSAGE", 3000)
    assert times(path) == [7]
    monkeypatch.setattr(limits, "LARGEST_MESSAGE", 2000)
    with pytest.raises(FlockError, match=r"a message in it has \d+ bytes, more than the limit"):
        times(path)


def test_what_a_file_without_a_summary_unpacks_to_is_limited(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Without a summary and without indexes of messages, every chunk is read when it is opened.
    packed = zstandard.compress(message(7, 10_000))
    one = chunk(packed, compression="zstd", size=len(message(7, 10_000)))
    path = write(tmp_path / "a.mcap", pack(CHANNEL) + one * 40)
    monkeypatch.setattr(limits, "CHUNKS_RATIO", 1)
    monkeypatch.setattr(limits, "CHUNKS_SIZE", 500_000)
    assert len(times(path)) == 40
    monkeypatch.setattr(limits, "CHUNKS_SIZE", 300_000)
    with pytest.raises(FlockError, match="unpacked bytes in its chunks, more than the limit"):
        BagReader(path)


def test_damaged_chunks_at_the_end_are_unpacked_to_a_limit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    packed = zstandard.compress(message(7, 10_000))
    torn = chunk(packed, compression="zstd", size=20_000)  # it does not have this size
    path = write(tmp_path / "a.mcap", pack(CHANNEL) + torn * 40)
    monkeypatch.setattr(limits, "CHUNKS_RATIO", 1)
    monkeypatch.setattr(limits, "CHUNKS_SIZE", 500_000)
    with pytest.raises(FlockError, match="unpacked bytes in its chunks, more than the limit"):
        BagReader(path)


def calls_of(monkeypatch: pytest.MonkeyPatch, *names: str) -> Callable[[Callable[[], object]], int]:
    """Return a function that counts the calls of functions of `os` while it calls another one."""
    calls: list[str] = []
    for name in names:
        real = getattr(os, name)

        def counted(*given: object, real: Callable[..., object] = real, **more: object) -> object:
            calls.append("")
            return real(*given, **more)

        monkeypatch.setattr(os, name, counted)

    def count(work: Callable[[], object]) -> int:
        calls.clear()
        work()
        return len(calls)

    return count


@pytest.mark.parametrize(("indexed", "most"), [(True, 10), (False, 45_000)])
def test_a_file_of_many_chunks_takes_few_reads_for_each(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, indexed: bool, most: int
) -> None:
    count, first = 10_000, len(MAGIC) + len(pack(CHANNEL))
    body = pack(CHANNEL) + b"".join(chunk(message(7)) for _ in range(count))
    length = len(chunk(message(7)))
    indexes = b"".join(chunk_index(first + k * length, length) for k in range(count))
    summary = pack(CHANNEL) + statistics(count) + indexes
    path = write(tmp_path / "a.mcap", body, summary if indexed else None)
    reads = calls_of(monkeypatch, "pread")
    assert reads(lambda: BagReader(path)) < most
    with BagReader(path) as bag:
        assert reads(lambda: list(bag.messages())) == 2 * count
        assert reads(lambda: list(bag.by_time([WORDS]))) == 2 * count


@pytest.mark.parametrize("with_metadata", [True, False])
def test_a_directory_of_many_other_files_is_listed_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, with_metadata: bool
) -> None:
    bag = write_bag(tmp_path / "bag", words(1))
    if not with_metadata:
        (bag / "metadata.yaml").unlink()
    calls = calls_of(monkeypatch, "stat", "lstat", "listdir", "scandir", "open")
    before = calls(lambda: listing(bag))
    for number in range(10_000):
        (bag / f"{number}.txt").touch()
    assert len(listing(bag).files) == 1
    assert calls(lambda: listing(bag)) == before
