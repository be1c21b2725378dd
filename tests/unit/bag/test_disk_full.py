# SPDX-License-Identifier: Apache-2.0
"""A disk that fills up in flight costs the last chunk, never the bag."""

import errno
import os
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

from flock_sim.bag.reading.reader import BagReader
from flock_sim.bag.topic import Topic
from flock_sim.bag.writing.writer import BagWriter
from flock_sim.errors import RunFailed

TOPICS = [Topic("/clock", "rosgraph_msgs/msg/Clock")]


class Disk:
    """Stands in for os.pwrite: stores `room` bytes more (None: any number) and is full then."""

    def __init__(self) -> None:
        self.room: int | None = None
        self._pwrite = os.pwrite

    def pwrite(self, fd: int, data: memoryview, offset: int) -> int:
        if self.room is None:
            return self._pwrite(fd, data, offset)
        if self.room == 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        done = self._pwrite(fd, data[: self.room], offset)
        self.room -= done
        return done


@pytest.fixture
def disk(monkeypatch: pytest.MonkeyPatch) -> Disk:
    disk = Disk()
    monkeypatch.setattr(os, "pwrite", disk.pwrite)
    return disk


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of 1 MiB of its own."""
    if os.geteuid() != 0:
        pytest.skip("only root can mount a small file system")
    mount = tmp_path / "disk"
    mount.mkdir()
    done = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=1m", "tmpfs", mount], capture_output=True, check=False
    )
    if done.returncode:
        pytest.skip(f"this machine does not mount: {done.stderr.decode().strip()}")
    try:
        yield mount
    finally:
        subprocess.run(["umount", mount], check=True)


def assert_complete_with(directory: Path, expected: list[bytes]) -> None:
    assert {entry.name for entry in directory.iterdir()} == {
        f"{directory.name}_0.mcap",
        "metadata.yaml",
    }
    with (directory / f"{directory.name}_0.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert [message.data for _, _, message in reader.iter_messages()] == expected
    with AnyReader([directory]) as other:
        assert [data for _, _, data in other.messages()] == expected
    with BagReader(directory) as bag:
        assert bag.missing is None
        assert [data for _, _, data in bag.messages()] == expected


@pytest.mark.parametrize("room", [0, 1, 50, 200])
def test_a_full_disk_keeps_every_whole_chunk_and_the_bag_is_completed(
    tmp_path: Path, disk: Disk, room: int
) -> None:
    bag = BagWriter(tmp_path / "bag", TOPICS, {"flock": {"birds": "2"}})
    bag.write(0, 1, b"one")
    bag.flush()
    bag.write(0, 2, b"two")
    bag.write(0, 3, os.urandom(400))
    disk.room = room
    whole = bag.path.stat().st_size
    with pytest.raises(RunFailed, match=r"No space left on device.*the 1 messages") as failed:
        bag.flush()
    assert bag.path.stat().st_size == whole
    disk.room = None  # what the reserve stands for: `close` has room
    with pytest.raises(RunFailed) as again:
        bag.write(0, 4, b"four")
    assert again.value is failed.value
    bag.close()
    assert_complete_with(tmp_path / "bag", [b"one"])


def test_a_disk_that_is_full_at_the_end_is_told_and_the_bag_is_completed(
    tmp_path: Path, disk: Disk
) -> None:
    bag = BagWriter(tmp_path / "bag", TOPICS, {})
    bag.write(0, 1, b"one")
    bag.flush()
    bag.write(0, 2, b"two")

    def fail_once(fd: int, data: memoryview, offset: int) -> int:
        os.pwrite = disk.pwrite
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    os.pwrite = fail_once  # the fixture restores it
    with pytest.raises(RunFailed, match="the 1 messages"):
        bag.close()
    assert_complete_with(tmp_path / "bag", [b"one"])


def test_without_room_for_the_summary_the_messages_are_still_read(
    tmp_path: Path, disk: Disk
) -> None:
    bag = BagWriter(tmp_path / "bag", TOPICS, {"flock": {"birds": "2"}})
    bag.write(0, 1, b"one")
    bag.flush()
    disk.room = 100
    with pytest.raises(RunFailed, match=r"can't be completed .*1 messages are safe"):
        bag.close()
    disk.room = None
    with BagReader(tmp_path / "bag") as reader:
        assert [data for _, _, data in reader.messages()] == [b"one"]
        assert reader.metadata("flock") == {"birds": "2"}
        assert reader.missing is not None


def test_without_room_to_begin_nothing_is_left(tmp_path: Path, disk: Disk) -> None:
    disk.room = 100
    with pytest.raises(RunFailed, match="can't be created"):
        BagWriter(tmp_path / "bag", TOPICS, {})
    assert list(tmp_path.iterdir()) == []


def test_the_reserve_grows_with_the_summary(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag", TOPICS, {}) as bag:
        reserve = tmp_path / "bag" / ".reserve"
        begin = reserve.stat().st_blocks * 512
        for step in range(3_000):
            bag.write(0, step, b"x")
            bag.flush()
        before = bag.path.stat().st_size
        held = reserve.stat().st_blocks * 512
    tail = bag.path.stat().st_size - before
    metadata = (tmp_path / "bag" / "metadata.yaml").stat().st_size
    assert held > begin > 0
    assert held >= tail + metadata


def test_without_room_to_go_on_a_complete_bag_stays_complete(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(fd: int, offset: int, size: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with BagWriter(tmp_path / "bag", TOPICS, {}) as bag:
        bag.write(0, 1, b"one")
    before = {entry.name: entry.read_bytes() for entry in (tmp_path / "bag").iterdir()}
    monkeypatch.setattr(os, "posix_fallocate", full)
    with pytest.raises(RunFailed, match=r"can't be continued \(No space left.*free disk space"):
        BagWriter(tmp_path / "bag", TOPICS, {}, resume=True)
    assert {e.name: e.read_bytes() for e in (tmp_path / "bag").iterdir()} == before
    monkeypatch.undo()
    with BagWriter(tmp_path / "bag", TOPICS, {}, resume=True) as bag:
        bag.write(0, 2, b"two")
    assert_complete_with(tmp_path / "bag", [b"one", b"two"])


def test_a_bag_that_a_full_disk_ended_is_gone_on_with_and_ended_by_another(
    tmp_path: Path, disk: Disk
) -> None:
    kept: list[bytes] = []
    for part in range(4):
        bag = BagWriter(tmp_path / "bag", TOPICS, {"flock": {"birds": "2"}}, resume=True)
        kept.append(b"kept %d" % part)
        bag.write(0, 2 * part, kept[-1])
        bag.flush()
        bag.write(0, 2 * part + 1, os.urandom(400))
        disk.room = 50 * part
        with pytest.raises(RunFailed, match=f"the {part + 1} messages"):
            bag.flush()
        disk.room = None  # what the reserve stands for: `close` has room
        bag.close()
        assert_complete_with(tmp_path / "bag", kept)


def test_the_reserve_of_a_bag_that_is_gone_on_with_is_for_all_of_its_summary(
    tmp_path: Path,
) -> None:
    reserve = tmp_path / "bag" / ".reserve"
    bag = BagWriter(tmp_path / "bag", TOPICS, {})
    for step in range(3_000):
        bag.write(0, step, b"x")
        bag.flush()
    held = reserve.stat().st_size
    bag.leave()
    assert not reserve.exists()
    with BagWriter(tmp_path / "bag", TOPICS, {}, resume=True):
        assert reserve.stat().st_size == held


def test_a_real_full_disk_ends_the_recording_with_a_complete_bag(small_disk: Path) -> None:
    directory = small_disk / "bag"
    sent: list[bytes] = []
    bag = BagWriter(directory, TOPICS, {"flock": {"birds": "2"}}, chunk_size=10_000)

    def record_for_ever() -> None:
        while True:
            sent.append(os.urandom(100))
            bag.write(0, len(sent), sent[-1])

    with pytest.raises(RunFailed, match="No space left on device"):
        record_for_ever()
    # Full to the last block: dd ends where the disk does.
    other = ["dd", "if=/dev/zero", f"of={small_disk / 'other'}", "bs=4096"]
    assert subprocess.run(other, capture_output=True, check=False).returncode == 1
    safe = bag.messages_safe
    assert safe > 1_000
    bag.close()
    assert_complete_with(directory, sent[:safe])


def test_a_bag_on_a_real_full_disk_is_gone_on_with_once_there_is_room(small_disk: Path) -> None:
    directory = small_disk / "bag"
    (small_disk / "other").write_bytes(bytes(300_000))
    kept: list[bytes] = []
    for _ in range(2):
        sent = list(kept)
        bag = BagWriter(directory, TOPICS, {"flock": {}}, chunk_size=10_000, resume=True)

        def record_for_ever(bag: BagWriter, sent: list[bytes]) -> None:
            while True:
                sent.append(os.urandom(100))
                bag.write(0, len(sent), sent[-1])

        with pytest.raises(RunFailed, match="No space left on device"):
            record_for_ever(bag, sent)
        assert bag.messages_safe > len(kept) + 1_000
        kept = sent[: bag.messages_safe]
        bag.close()
        assert_complete_with(directory, kept)
        (small_disk / "other").unlink(missing_ok=True)


def test_metadata_that_finds_no_room_is_left_out_and_that_at_the_end_is_not(
    tmp_path: Path, disk: Disk
) -> None:
    bag = BagWriter(tmp_path / "bag", TOPICS, {})
    bag.write("/clock", 0, b"safe")
    bag.flush()
    disk.room = 10
    with pytest.raises(RunFailed, match="No space left"):
        bag.add_metadata("note", {"by": "us"})
    disk.room = None
    with pytest.raises(RunFailed, match="No space left"):
        bag.add_metadata("another", {})
    bag.close({"last": {"digest": "x"}})
    assert_complete_with(tmp_path / "bag", [b"safe"])
    with BagReader(tmp_path / "bag") as reader:
        assert reader.records == {"last": {"digest": "x"}}
