# SPDX-License-Identifier: Apache-2.0
"""A bag holds the digest of exactly its states, and the machines that recorded them."""

import errno
import os
import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from flock_sim.analysis.state_digest import StateDigest
from flock_sim.bag.writing.writer import BagWriter
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.console.arguments import run_tool
from flock_sim.errors import FlockError, RunFailed
from flock_sim.recording import flight_writer
from flock_sim.recording.flight_writer import Recording, lay_down, recording
from flock_sim.recording.machine import Machine, this_machine
from flock_sim.recording.row_assembler import Row
from flock_sim.recording.row_digest import RowDigest
from flock_sim.recording.run import Run
from flock_sim.reference.integrator import Reference
from flock_tools.commands import repair
from support.flights import flown_rows, record

CONFIGURATION = FlockConfiguration(birds=3, t_max=60.0, record_every=2, span_ratios=("2=1,1.05",))
ROWS = flown_rows(CONFIGURATION)
HERE = this_machine()
THERE = replace(HERE, processor="another", c_library="musl 1.2")


def expected(rows: int = len(ROWS)) -> str:
    """Return the digest of the first `rows` rows, from the reference itself."""
    digest = StateDigest()
    for _, state in zip(range(rows), Reference(CONFIGURATION).fly(), strict=False):
        digest.add(state)
    return f"sha256:{digest.hexdigest()}"


def write(run: Recording, rows: list[Row]) -> None:
    for row in rows:
        run.write_row(row)


def flown(directory: Path, rows: int, machines: Sequence[Machine] | None = None) -> Path:
    """Fly a flight, or its rest, up to `rows` rows; it ends as by Ctrl-C. Return its directory."""
    with recording(directory, CONFIGURATION, grants=True, resume=True, machines=machines) as run:
        write(run, [row for row in ROWS[:rows] if row.step > run.saved])
    return directory


def killed(directory: Path, rows: int, machines: Sequence[Machine] | None = None) -> Path:
    """Fly likewise, and leave the bag as a kill does after its last chunk."""
    run = Recording(directory, CONFIGURATION, grants=True, resume=True, machines=machines or [HERE])
    write(run, [row for row in ROWS[:rows] if row.step > run.saved])
    run.bag.leave()
    return directory


def digest_in(directory: Path) -> str | None:
    with Run(directory) as run:
        return run.state_digest


def machines_in(directory: Path) -> list[Machine]:
    with Run(directory) as run:
        return run.machines


@pytest.fixture
def small_chunks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(BagWriter.__init__.__kwdefaults__, "chunk_size", 4096)


@pytest.mark.parametrize("rows", [1, 7, len(ROWS)])
def test_a_flight_has_the_digest_of_the_reference_to_its_end(tmp_path: Path, rows: int) -> None:
    bag = flown(tmp_path / "bag", rows)
    assert digest_in(bag) == expected(rows)
    assert machines_in(bag) == [HERE]


def test_a_bag_of_single_messages_has_the_digest_of_its_rows(tmp_path: Path) -> None:
    assert digest_in(record(tmp_path / "bag", CONFIGURATION, grants=True)) == expected()
    by_bird = record(tmp_path / "by_bird", CONFIGURATION, bird_by_bird=True)
    assert digest_in(by_bird) is None


def test_a_flight_in_parts_has_the_digest_of_all_its_states(
    tmp_path: Path, small_chunks: None
) -> None:
    for rows in range(4, len(ROWS), 4):
        bag = (flown if rows % 8 else killed)(tmp_path / "bag", rows)
        assert digest_in(bag) == (expected(rows) if rows % 8 else None)
    flown(bag, len(ROWS))
    assert digest_in(bag) == expected()
    assert machines_in(bag) == [HERE]


def test_wherever_a_flight_is_cut_off_it_ends_with_the_digest_of_the_reference(
    tmp_path: Path, small_chunks: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "fsync", lambda fd: None)
    flown(tmp_path / "whole", len(ROWS))
    (path,) = (tmp_path / "whole").glob("*.mcap")
    size = path.stat().st_size
    for cut in [*range(0, size, size // 60), *range(size - 900, size, 97), size]:
        bag = tmp_path / "cut"
        bag.mkdir()
        (bag / "bag_0.mcap").write_bytes(path.read_bytes()[:cut])
        flown(bag, len(ROWS))
        assert digest_in(bag) == expected(), cut
        assert machines_in(bag) == [HERE], cut
        shutil.rmtree(bag)


def test_a_restarted_recorder_reads_the_rows_before_once_and_not_at_the_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bag = killed(tmp_path / "bag", 9)
    with recording(bag, CONFIGURATION, grants=True, resume=True) as run:
        monkeypatch.setattr(flight_writer, "digest_of", lambda *_: pytest.fail("read again"))
        write(run, ROWS[9:])
    assert digest_in(bag) == expected()


def test_rows_that_can_t_be_read_again_have_no_digest_and_that_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(*_: object) -> None:
        raise FlockError("the bag can't be read: Input/output error")

    bag = killed(tmp_path / "bag", 9)
    monkeypatch.setattr(flight_writer, "digest_of", fail)
    flown(bag, len(ROWS))
    assert digest_in(bag) is None
    warning = "the bag can't be read: Input/output error; so the bag gets no digest of its states"
    assert capsys.readouterr().err == f"warning: {warning}\n"


def test_a_bag_that_was_not_closed_has_no_digest_and_its_machine(tmp_path: Path) -> None:
    bag = killed(tmp_path / "bag", 9)
    assert digest_in(bag) is None
    assert machines_in(bag) == [HERE]


def test_a_bag_without_rows_has_neither(tmp_path: Path) -> None:
    lay_down(tmp_path / "begun", CONFIGURATION, grants=True, stages=False)
    assert digest_in(tmp_path / "begun") is None
    bag = flown(tmp_path / "bag", 0)
    assert digest_in(bag) is None
    assert machines_in(bag) == []


def test_each_machine_that_recorded_rows_is_in_the_bag_once(
    tmp_path: Path, small_chunks: None
) -> None:
    bag = killed(tmp_path / "bag", 10)
    killed(bag, 20, [THERE])
    flown(bag, 20, [replace(HERE, numpy="1")])  # writes no row
    assert machines_in(bag) == [HERE, THERE]
    flown(bag, len(ROWS), [HERE])
    assert machines_in(bag) == [HERE, THERE]
    assert digest_in(bag) == expected()


def interrupted(directory: Path, at_row: int, place: type, name: str) -> None:
    """Fly until Ctrl-C comes in the method `name` of `place`, after row `at_row` was written."""

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    with recording(directory, CONFIGURATION, grants=True) as run:
        write(run, ROWS[:at_row])
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(place, name, interrupt)
            run.write_row(ROWS[at_row])
            run._digest.text  # noqa: B018  (rows are hashed)


@pytest.mark.parametrize("at_row", [0, 3, 20])
@pytest.mark.parametrize(("place", "name"), [(RowDigest, "add"), (StateDigest, "add_rows")])
def test_an_interrupted_recording_has_the_digest_of_the_rows_in_it(
    tmp_path: Path, at_row: int, place: type, name: str
) -> None:
    with pytest.raises(KeyboardInterrupt):
        interrupted(tmp_path / "bag", at_row, place, name)
    assert digest_in(tmp_path / "bag") == expected(at_row + 1)


class Disk:
    """Stands in for os.pwrite: it stores nothing while it is `full`."""

    def __init__(self) -> None:
        self.full = False
        self._pwrite = os.pwrite

    def pwrite(self, fd: int, data: bytes, offset: int) -> int:
        if self.full:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return self._pwrite(fd, data, offset)


def filling_up(disk: Disk, directory: Path, full_at: int) -> None:
    """Fly a flight whose disk is full from row `full_at` on; its end fits into freed space."""
    with recording(directory, CONFIGURATION, grants=True) as run:
        write(run, ROWS[:full_at])
        disk.full = True
        try:
            write(run, ROWS[full_at:])
        finally:
            disk.full = False


@pytest.mark.parametrize("full_at", [10, 20])
def test_a_full_disk_leaves_the_digest_of_the_rows_that_are_on_it(
    tmp_path: Path, small_chunks: None, monkeypatch: pytest.MonkeyPatch, full_at: int
) -> None:
    disk = Disk()
    monkeypatch.setattr(os, "pwrite", disk.pwrite)
    with pytest.raises(RunFailed, match="No space left"):
        filling_up(disk, tmp_path / "bag", full_at)
    with Run(tmp_path / "bag") as run:
        rows = sum(1 for _ in run.snapshots())
        assert run.state_digest == expected(rows)
    assert 0 < rows < len(ROWS)


def test_repair_gives_the_digest_of_what_is_whole_and_keeps_the_machines(
    tmp_path: Path, small_chunks: None
) -> None:
    bag = killed(tmp_path / "bag", 10, [THERE])
    killed(bag, 20)
    (path,) = bag.glob("*.mcap")
    os.truncate(path, path.stat().st_size * 9 // 10)
    assert run_tool(repair.tool, [str(bag)]) == 0
    repaired = tmp_path / "bag-repaired"
    with Run(repaired) as run:
        rows = sum(1 for _ in run.snapshots())
    assert 10 < rows < 20
    assert digest_in(repaired) == expected(rows)
    assert machines_in(repaired) == [THERE, HERE]
    flown(repaired, len(ROWS))
    assert digest_in(repaired) == expected()


def test_repair_of_a_bag_from_before_adds_no_machine(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(flight_writer, "result_record", lambda digest: {})
    bag = flown(tmp_path / "bag", 9, [])
    monkeypatch.undo()
    assert (digest_in(bag), machines_in(bag)) == (None, [])
    (bag / "metadata.yaml").unlink()
    assert run_tool(repair.tool, [str(bag)]) == 0
    repaired = tmp_path / "bag-repaired"
    assert (digest_in(repaired), machines_in(repaired)) == (expected(9), [])
