# SPDX-License-Identifier: Apache-2.0
"""`repair` writes a valid bag of all intact messages, and of nothing else."""

import os
import random
from dataclasses import replace
from pathlib import Path

import pytest
from mcap.reader import make_reader
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


@pytest.mark.parametrize("named", [".", "FILE"])
def test_a_bag_is_repaired_from_within_its_directory(
    flight: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    named: str,
) -> None:
    run = torn(flight, tmp_path / "torn", next(flight.glob("*.mcap")).stat().st_size - 40)
    monkeypatch.chdir(run)
    found = json_of(tool, capsys, "torn_0.mcap" if named == "FILE" else named)
    assert found["output"] == str(tmp_path / "torn-repaired")
    assert messages(tmp_path / "torn-repaired") == messages(flight)
    (run / "inner").mkdir()
    monkeypatch.chdir(run / "inner")
    assert json_of(tool, capsys, "..", "--force")["output"] == str(tmp_path / "torn-repaired")


def test_whole_messages_of_a_chunk_that_is_cut_are_kept(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    whole_bag = record(tmp_path / "run", replace(CONFIGURATION, t_max=5000.0))
    whole = messages(whole_bag)
    (file,) = whole_bag.glob("*.mcap")
    with file.open("rb") as opened:
        last = make_reader(opened).get_summary().chunk_indexes[-1]
    within = last.chunk_start_offset + int(0.9 * last.chunk_length)
    before = sum(1 for _ in messages(torn(whole_bag, tmp_path / "cut", within)))
    found = json_of(tool, capsys, str(tmp_path / "cut"))
    kept = messages(tmp_path / "cut-repaired")
    assert kept == whole[: len(kept)]
    # Blocks of zstd have up to 128 KB, of which the last is not whole.
    assert len(kept) - before > 0.5 * (len(whole) - before)
    assert f"the {len(kept) - before} whole messages at the beginning of" in found["cut"]
    assert found["messages"] == len(kept)
    with Run(tmp_path / "cut-repaired") as run:
        assert 3 * run.at().step > 0.9 * before
        assert run.missing is not None


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
