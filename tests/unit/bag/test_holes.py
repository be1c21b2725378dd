# SPDX-License-Identifier: Apache-2.0
"""Damage anywhere in a bag is found, costs at most its chunk, and is flown again."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap.records import ChunkIndex

from flock_sim.bag.reading.reader import BagReader
from flock_sim.bag.writing import put_aside
from flock_sim.bag.writing.writer import BagWriter
from flock_sim.commands.resume import EXCLUDED, Resumable, resumable
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.configuration.perturbation import Perturbation
from flock_sim.errors import FlockError, RunFailed
from flock_sim.messages import topics
from flock_sim.messages.handshake import handshake
from flock_sim.messages.types import Grant, Push
from flock_sim.protocol.requests import refuses_push
from flock_sim.recording.flight_writer import Recording, lay_down, recording
from flock_sim.recording.run import Run
from flock_tools.commands.repair import tool
from support.flights import flown_rows
from support.tool_runs import error_of, json_of, text_of

CONFIGURATION = FlockConfiguration(birds=3, t_max=120.0, record_every=2)
ROWS = flown_rows(CONFIGURATION)
STEPS = [row.step for row in ROWS]
GRANT = Grant(7, 60, 120, 1.0, 1, handshake(CONFIGURATION)).encode()


def write(run: Recording) -> None:
    """Record what is left of the flight."""
    for row in ROWS:
        if row.step > run.saved:
            if row.step % 20 == 0:
                run.write_grant(GRANT)
            run.write_row(row)


@pytest.fixture
def flight(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A complete bag of many chunks; returns its file."""
    monkeypatch.setitem(BagWriter.__init__.__kwdefaults__, "chunk_size", 4096)
    with recording(tmp_path / "bag", CONFIGURATION, grants=True) as run:
        write(run)
    return run.bag.path


def chunks(path: Path) -> list[ChunkIndex]:
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    return sorted(summary.chunk_indexes, key=lambda chunk: chunk.chunk_start_offset)


def flip(path: Path, offset: int) -> bytes:
    """Change a byte; return what the file is then."""
    data = bytearray(path.read_bytes())
    data[offset] ^= 0x41
    path.write_bytes(data)
    return bytes(data)


def tear(path: Path) -> None:
    """Leave the bag as a kill does: without its end."""
    last = chunks(path)[-1]
    end = last.chunk_start_offset + last.chunk_length + last.message_index_length
    path.write_bytes(path.read_bytes()[:end])
    (path.parent / "metadata.yaml").unlink()


def states(path: Path) -> list[tuple[int, int, bytes]]:
    with Run(path) as run:
        return [(state.step, bird, state.encode()) for bird, state in run.states()]


WHOLE = [(row.step, bird, data) for row in ROWS for bird, data in enumerate(row.states, start=1)]


def resumed(path: Path) -> Resumable:
    """Return what `fly --resume` makes of a bag."""
    options = argparse.Namespace(**dict.fromkeys([*EXCLUDED, "law"]))
    with resumable(path.parent, options) as found:
        return found


def flown_on(path: Path) -> int:
    """Go on with the flight to its end; return the step behind which that was."""
    with recording(path.parent, CONFIGURATION, grants=True, resume=True) as run:
        saved = run.saved
        write(run)
    with Run(path.parent) as whole:
        assert whole.missing is None
    assert states(path.parent) == WHOLE
    assert resumed(path).complete
    return saved


@pytest.mark.parametrize("end", ["complete", "torn"])
@pytest.mark.parametrize("where", ["data", "length", "head", "index"])
def test_damage_in_the_middle_is_put_aside_and_flown_again(
    flight: Path, where: str, end: str
) -> None:
    found = chunks(flight)
    assert len(found) > 5
    for number in (0, 2, len(found) - 2):
        for entry in flight.parent.iterdir():
            entry.unlink()
        with recording(flight.parent, CONFIGURATION, grants=True) as run:
            write(run)
        assert resumed(flight).complete
        if end == "torn":
            tear(flight)
        start, length = found[number].chunk_start_offset, found[number].chunk_length
        places = {"data": length - 3, "length": 2, "head": 15, "index": length + 12}
        damaged = flip(flight, start + places[where])
        assert not resumed(flight).complete
        saved = flown_on(flight)
        before = [m for m in STEPS if CONFIGURATION.stamp(m) < found[number].message_start_time]
        assert saved == (before[-1] if before else -1)
        assert flight.with_name(f"{flight.name}.damaged").read_bytes() == damaged


def test_a_complete_bag_is_read_before_it_is_called_so(flight: Path) -> None:
    assert resumed(flight).complete
    for chunk in chunks(flight):
        for offset in (chunk.chunk_start_offset + 30, chunk.chunk_start_offset + 90):
            flip(flight, offset)
            assert not resumed(flight).complete
            flip(flight, offset)
    assert resumed(flight).complete


def test_a_damaged_file_is_put_aside_beside_others(flight: Path) -> None:
    for name in ("bag_0.mcap.damaged", "bag_0.mcap.damaged-2"):
        damaged = flip(flight, chunks(flight)[3].chunk_start_offset + 50)
        flown_on(flight)
        assert flight.with_name(name).read_bytes() == damaged


def test_where_a_copy_has_no_room_nothing_is_lost(
    flight: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    damaged = flip(flight, chunks(flight)[3].chunk_start_offset + 50)

    def full(self: object, block: bytes) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(put_aside.AppendFile, "append", full)
    with (
        pytest.raises(RunFailed, match=r"can't be copied \(No space left"),
        recording(flight.parent, CONFIGURATION, grants=True, resume=True),
    ):
        pass
    assert flight.read_bytes() == damaged
    assert sorted(entry.name for entry in flight.parent.iterdir()) == [
        "bag_0.mcap",
        "metadata.yaml",
    ]
    monkeypatch.undo()
    flown_on(flight)


def test_repair_keeps_what_is_behind_a_hole_and_names_the_steps(
    flight: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for number, where in ((1, "data"), (3, "length"), (4, "data")):
        hurt = chunks(flight)[number]
        place = 2 if where == "length" else hurt.chunk_length - 4
        flip(flight, hurt.chunk_start_offset + place)
        if number == 4:
            tear(flight)
        output = tmp_path / f"repaired{number}"
        found = json_of(tool, capsys, str(flight.parent), "--output", str(output))
        # The first and the last step of a chunk may have all their states in other chunks.
        first, last = hurt.message_start_time, hurt.message_end_time
        hit = [step for step in STEPS if first <= CONFIGURATION.stamp(step) <= last]
        lost = found["missing_steps"]
        assert lost
        assert lost in (hit, hit[1:], hit[:-1], hit[1:-1])
        assert f"is damaged at byte {hurt.chunk_start_offset}" in found["broken"]
        assert states(output) == [state for state in WHOLE if state[0] not in lost]
        with recording(output, CONFIGURATION, grants=True, resume=True) as run:
            assert run.saved == lost[0] - 2
            write(run)
        assert states(output) == WHOLE  # a hole in the steps is flown again, too
        if number != 4:
            flip(flight, hurt.chunk_start_offset + place)
            text = text_of(tool, capsys, str(flight.parent))
            assert text == f"{flight.parent} is complete: nothing to repair\n"


def test_the_last_chunk_is_missed_too(
    flight: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    last = chunks(flight)[-1]
    flip(flight, last.chunk_start_offset + last.chunk_length - 4)
    found = json_of(tool, capsys, str(flight.parent))
    assert found["missing_steps"] == [
        step for step in STEPS if CONFIGURATION.stamp(step) >= last.message_start_time
    ]


@pytest.mark.parametrize("killed", [False, True])
def test_a_push_behind_a_hole_is_flown_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, killed: bool
) -> None:
    monkeypatch.setitem(BagWriter.__init__.__kwdefaults__, "chunk_size", 4096)
    push = Push.of(7, 1, Perturbation(100, 2, 1, 0.5, 0.0))
    with recording(tmp_path / "bag", CONFIGURATION, grants=True) as run:
        for row in ROWS[:45]:
            run.write_row(row)
        run.write_perturbation(push)
        for row in ROWS[45:50]:
            run.write_row(row)
    path = run.bag.path
    flip(path, chunks(path)[1].chunk_start_offset + 60)
    if killed:  # between the two
        with monkeypatch.context() as patch:
            patch.setattr(Recording, "_keep_pushes", lambda self, aside: None)
            lay_down(tmp_path / "bag", CONFIGURATION, grants=True, stages=False, resume=True)
    with recording(tmp_path / "bag", CONFIGURATION, grants=True, resume=True) as run:
        assert run.live == {1: push}
        assert run.saved < 100
    with Run(tmp_path / "bag") as again:
        assert again.perturbations() == push.each(CONFIGURATION.members)


def test_what_a_new_recorder_needs_of_clock_and_pushes_is_found_behind_a_hole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(BagWriter.__init__.__kwdefaults__, "chunk_size", 4096)
    pushes = [Push(7, 100, 0.1 * epoch, 0.0, epoch, 2, 0) for epoch in (2**32 - 1, 1, 2)]
    grant = Grant(7, 60, 120, 1.0, 2**32 - 1, handshake(CONFIGURATION))
    with recording(tmp_path / "bag", CONFIGURATION, grants=True) as run:
        run.write_grant(grant.encode())
        run.write_perturbation(pushes[0])
        for row in ROWS[:45]:
            run.write_row(row)
        for push in pushes[:0:-1]:  # whatever the order in which files were put aside
            run.write_perturbation(push)
        run.write_grant(replace(grant, epoch=2).encode())
    flip(run.bag.path, chunks(run.bag.path)[1].chunk_start_offset + 60)
    with recording(tmp_path / "bag", CONFIGURATION, grants=True, resume=True) as run:
        assert list(run.live.values()) == pushes
        assert run.last_grant == grant
    with Run(tmp_path / "bag") as again:
        assert again.perturbations() == [one for push in pushes for one in push.each(1)]


@pytest.mark.parametrize(
    "bad",
    [
        Push(7, 20, 0.5, 0.0, 2, 4, 1),
        Push(7, 20, 0.5, 0.0, 2, 2, 9),
        Push(7, 500, 0.5, 0.0, 2, 2, 1),
        Push(7, 500, 0.5, 0.0, 2, 2, 0),
        Push(7, 20, float("nan"), 0.0, 2, 2, 1),
        Push(7, 20, 0.5, 0.0, 0, 2, 1),
    ],
)
def test_a_bag_poisoned_by_a_push_is_healed_by_repair(
    tmp_path: Path, bad: Push, capsys: pytest.CaptureFixture[str]
) -> None:
    assert refuses_push(bad, CONFIGURATION, -1)  # nor is it recorded
    good = Push.of(7, 1, Perturbation(40, 2, 1, 0.5, 0.0))
    with recording(tmp_path / "bag", CONFIGURATION, grants=True) as run:
        for row in ROWS[:8]:
            run.write_row(row)
        run.write_perturbation(good)
        run.write_perturbation(bad)
        run.write_perturbation(Push.of(7, 1, Perturbation(60, 1, 1, 0.1, 0.0)))
    with pytest.raises(FlockError, match=r"remove it with \./flock repair"):
        resumed(run.bag.path)
    found = json_of(tool, capsys, str(tmp_path / "bag"))
    assert found["invalid_perturbations"] == 2
    repaired = tmp_path / "bag-repaired"
    with recording(repaired, CONFIGURATION, grants=True, resume=True) as again:
        assert again.live == {1: good}
        assert again.saved == ROWS[7].step


def test_a_configuration_that_is_not_what_was_flown_is_refused(
    flight: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    tear(flight)
    data = flight.read_bytes()
    at = data.index(b"120.0")
    flight.write_bytes(data[:at] + b"160.0" + data[at + 5 :])
    before = flight.read_bytes()
    with pytest.raises(FlockError, match="its configuration is not what was flown"):
        resumed(flight)
    assert "its configuration is not what was flown" in error_of(tool, capsys, str(flight.parent))
    assert flight.read_bytes() == before


@pytest.mark.parametrize("stages", [False, True])
def test_a_bag_torn_within_its_head_is_flown_from_the_start_or_told_so(
    tmp_path: Path, stages: bool
) -> None:
    lay_down(tmp_path / "bag", CONFIGURATION, grants=True, stages=stages)
    path = tmp_path / "bag" / "bag_0.mcap"
    head = path.read_bytes()
    last = len(head) - 1
    outcomes = set()
    for size in (*range(8, last, 37), last):
        path.write_bytes(head[:size])
        try:
            found = resumed(path)
        except FlockError as error:
            outcomes.add("told" if "damaged at its beginning" in str(error) else str(error))
            continue
        assert (found.complete, found.stages) == (False, stages)
        outcomes.add("flown")
        lay_down(tmp_path / "bag", CONFIGURATION, grants=True, stages=stages, resume=True)
        assert path.read_bytes() == head
    assert outcomes == {"told", "flown"}


def test_a_flight_that_was_interrupted_before_its_first_row_is_flown_from_the_start(
    tmp_path: Path,
) -> None:
    for grants in (0, 1):
        bag = tmp_path / f"bag{grants}"
        lay_down(bag, CONFIGURATION, grants=True, stages=False)
        with recording(bag, CONFIGURATION, grants=True, resume=True) as run:
            for _ in range(grants):
                run.write_grant(GRANT)
        (path,) = bag.glob("*.mcap")
        assert not resumed(path).complete
        assert flown_on(path) == -1


def test_the_bag_that_only_records_its_start_is_complete_with_that(tmp_path: Path) -> None:
    flown = FlockConfiguration(birds=1, t_max=5.0, record_every=10)
    with recording(tmp_path / "bag", flown, grants=True) as run:
        run.write_grant(Grant(7, 5, 5, 1.0, 1).encode())
    assert not resumed(run.bag.path).complete
    with recording(tmp_path / "bag", flown, grants=True, resume=True) as run:
        run.write_row(flown_rows(flown)[0])
    assert resumed(run.bag.path).complete
    with BagReader(tmp_path / "bag") as bag:
        assert len(list(bag.messages([topics.CLOCK_TOPIC]))) == 1


def test_topics_that_a_torn_bag_no_longer_tells_are_not_guessed(
    flight: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    tear(flight)
    data = flight.read_bytes()
    at = data.index(topics.state_topic(2).encode())
    flight.write_bytes(data[: at + 14] + b"3" + data[at + 15 :])  # bird 2's are now bird 3's
    before = flight.read_bytes()
    for error in (error_of(tool, capsys, str(flight.parent)), refused(flight)):
        assert "its beginning" in error
    assert flight.read_bytes() == before


def refused(path: Path) -> str:
    """Return why a bag is not gone on with."""
    with (
        pytest.raises(FlockError) as told,
        recording(path.parent, CONFIGURATION, grants=True, resume=True),
    ):
        pass
    return str(told.value)
