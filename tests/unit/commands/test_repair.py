# SPDX-License-Identifier: Apache-2.0
"""`repair` writes a valid bag of all intact messages, and of nothing else."""

import os
import random
from pathlib import Path

import pytest
from rosbags.rosbag2 import Reader

from flock_sim.bag.reading.reader import BagReader
from flock_sim.bag.writing.writer import BagWriter
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.recording.run import Run
from flock_tools.commands.repair import examine, rewrite, tool
from support.flights import record
from support.tool_runs import error_of, json_of, text_of

CONFIGURATION = FlockConfiguration(birds=3, t_max=400.0, record_every=1)


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("flight") / "run", CONFIGURATION, grants=True)


def torn(flight: Path, to: Path, size: int) -> Path:
    """Return a copy of a bag as a kill -9 leaves it: no metadata.yaml, cut off at `size` bytes."""
    to.mkdir()
    (source,) = flight.glob("*.mcap")
    copy = to / f"{to.name}_0.mcap"
    copy.write_bytes(source.read_bytes()[:size])
    return to


def messages(bag: Path) -> list[tuple[str, int, bytes]]:
    with BagReader(bag) as reader:
        return list(reader.messages())


def test_a_torn_bag_becomes_a_proper_one(
    flight: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (file,) = flight.glob("*.mcap")
    run = torn(flight, tmp_path / "torn", file.stat().st_size - 40)
    found = json_of(tool, capsys, str(run))
    assert found["output"] == str(tmp_path / "torn-repaired")
    assert "no metadata.yaml" in found["missing"]
    assert (found["broken"], found["left_out"]) == (None, 0)
    # Only the end of the summary was lost: everything that was recorded is there again.
    assert messages(tmp_path / "torn-repaired") == messages(flight)
    assert found["messages"] == len(messages(flight))
    with Run(tmp_path / "torn-repaired") as repaired, Run(flight) as sound:
        assert repaired.missing is None
        assert repaired.configuration == sound.configuration
        assert repaired.bag.message_counts == sound.bag.message_counts
    with Reader(tmp_path / "torn-repaired") as other:  # another project's reader of rosbag2
        assert other.message_count == found["messages"]


def test_whole_messages_are_kept_wherever_a_bag_is_torn(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Many chunks, of which the last ones are lost.
    monkeypatch.setitem(BagWriter.__init__.__kwdefaults__, "chunk_size", 4096)
    flight = record(tmp_path / "run", CONFIGURATION)
    (file,) = flight.glob("*.mcap")
    whole, size, chance = messages(flight), file.stat().st_size, random.Random(3)
    kept = set()
    for number in range(40):
        run = torn(flight, tmp_path / f"torn{number}", chance.randrange(size // 4, size))
        with Run(run) as old:
            damage = examine(old)
            assert damage.missing is not None
            rewrite(old, tmp_path / f"new{number}")
        found = messages(tmp_path / f"new{number}")
        assert len(found) == damage.messages
        assert found == whole[: len(found)]
        kept.add(len(found))
    assert len(kept) > 10


def test_a_single_file_is_repaired_beside_its_bag(
    flight: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (file,) = flight.glob("*.mcap")
    run = torn(flight, tmp_path / "torn", file.stat().st_size - 1)
    (copy,) = run.glob("*.mcap")
    text = text_of(tool, capsys, str(copy))
    assert text.splitlines()[-1] == (
        f"{len(messages(flight))} intact messages are in {tmp_path / 'torn-repaired'}"
    )


def test_what_is_complete_is_left_alone(flight: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert text_of(tool, capsys, str(flight)) == f"{flight} is complete: nothing to repair\n"
    assert not flight.with_name("run-repaired").exists()


def test_a_bag_is_kept_up_to_a_damaged_chunk(
    flight: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (file,) = flight.glob("*.mcap")
    run = torn(flight, tmp_path / "hurt", file.stat().st_size)
    (copy,) = run.glob("*.mcap")
    data = bytearray(copy.read_bytes())
    data[len(data) // 2] ^= 255
    copy.write_bytes(data)
    (run / "metadata.yaml").write_bytes((flight / "metadata.yaml").read_bytes())
    with Run(run) as hurt:
        damage = examine(hurt)
    assert damage.broken is not None
    if damage.messages == 0:
        assert "it has no intact message" in error_of(tool, capsys, str(run))
    else:
        assert "is damaged at byte" in text_of(tool, capsys, str(run))


def test_bad_input_is_one_line(
    flight: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert "there is no bag" in error_of(tool, capsys, str(tmp_path / "nothing"))
    run = torn(flight, tmp_path / "torn", 100)
    assert "not a bag of Flock's" in error_of(tool, capsys, str(run))
    (file,) = flight.glob("*.mcap")
    run = torn(flight, tmp_path / "whole", file.stat().st_size - 1)
    (tmp_path / "there").mkdir()
    assert "exists: add --force" in error_of(
        tool, capsys, str(run), "--output", str(tmp_path / "there")
    )
    os.truncate(next(run.glob("*.mcap")), 8)
    assert error_of(tool, capsys, str(run))
