# SPDX-License-Identifier: Apache-2.0
"""A flight's bag has whole rows, and is resumed behind the last one on disk."""

import os
import random
import shutil
import signal
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap.records import Chunk
from mcap.stream_reader import StreamReader, breakup_chunk
from rosbags.highlevel import AnyReader

from flock_sim.bag.reading.reader import BagReader
from flock_sim.bag.writing.writer import BagWriter
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.errors import FlockError, RunFailed
from flock_sim.launcher.reference_flight import row as row_of
from flock_sim.messages import topics
from flock_sim.messages.types import Grant, Stage
from flock_sim.recording import flight_bag
from flock_sim.recording.flight_bag import has_stages
from flock_sim.recording.flight_writer import Recording, lay_down, recording
from flock_sim.recording.row_assembler import Row
from flock_sim.recording.run import Run
from flock_sim.reference.integrator import Reference
from support.flights import record

CONFIGURATION = FlockConfiguration(birds=3, t_max=60.0, record_every=2, span_ratios=("2=1,1.05",))
BIRDS = range(1, CONFIGURATION.birds + 1)
ROWS = [row_of(CONFIGURATION, recorded) for recorded in Reference(CONFIGURATION).fly()]
STATES = [(row.step, bird, data) for row in ROWS for bird, data in enumerate(row.states, start=1)]


def with_stages(row: Row) -> Row:
    """The row with stages of each bird, whose numbers do not matter here."""
    numbers = CONFIGURATION.span_ratio[0]
    stages = [
        (bird, Stage(0, step, 0, bird, stage, numbers, numbers, numbers).encode())
        for step in range(max(0, row.step - CONFIGURATION.record_every), row.step)
        for stage in range(4)
        for bird in BIRDS
    ]
    return Row(row.step, row.wings, stages, row.time, row.states)


def grant(step: int) -> bytes:
    return Grant(0, step, CONFIGURATION.steps, CONFIGURATION.dt, 3).encode()


def write(run: Recording, rows: list[Row]) -> None:
    """Write rows, and grants as they come in a flight: before, between and after."""
    for row in rows:
        if row.step % 14 == 0:
            run.write_grant(grant(row.step))
        run.write_row(row)


def rest(run: Recording) -> list[Row]:
    return [row for row in ROWS if row.step > run.saved]


@pytest.fixture
def small_chunks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(BagWriter.__init__.__kwdefaults__, "chunk_size", 4096)


def states_of(path: Path) -> list[tuple[int, int, bytes]]:
    """Step, bird and state in the order of the file, read by mcap from front to back, strictly."""
    channels: dict[int, str] = {}
    found = []
    with path.open("rb") as file:
        for record in StreamReader(file, validate_crcs=True).records:
            if type(record).__name__ == "Channel":
                channels[record.id] = record.topic
            elif type(record).__name__ == "Message" and channels[record.channel_id].endswith("e"):
                bird = int(channels[record.channel_id].split("_")[1][:2])
                found.append((int.from_bytes(record.data[28:36], "little"), bird, record.data))
    return found


def recording_in(directory: Path) -> Path:
    (path,) = directory.glob("*.mcap")
    return path


def assert_undisturbed(directory: Path) -> None:
    """The bag is complete and holds each state of the flight once, to the bit and in order."""
    path = recording_in(directory)
    assert {entry.name for entry in directory.iterdir()} == {path.name, "metadata.yaml"}
    assert states_of(path) == STATES
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        counted = dict.fromkeys(summary.channels, 0)
        for _, channel, _ in reader.iter_messages():
            counted[channel.id] += 1
        assert summary.statistics.channel_message_counts == {
            channel: count for channel, count in counted.items() if count
        }
    with AnyReader([directory]) as other:
        assert other.message_count == sum(counted.values())
        names = {topics.state_topic(bird) for bird in BIRDS}
        wanted = [c for c in other.connections if c.topic in names]
        assert {data for _, _, data in other.messages(wanted)} == {data for *_, data in STATES}
    with Run(directory) as run:
        assert run.missing is None
        assert sorted(run.wings()) == list(BIRDS)
        times = [time for _, time, _ in run.bag.messages(topics=[topics.CLOCK_TOPIC])]
        assert times == [CONFIGURATION.stamp(row.step) for row in ROWS]


def flown(directory: Path, rows: list[Row] = ROWS) -> Path:
    with recording(directory, CONFIGURATION, grants=True) as run:
        write(run, rows)
    return recording_in(directory)


def cut_copy(path: Path, to: Path, size: int) -> Path:
    to.mkdir()
    (to / "bag_0.mcap").write_bytes(path.read_bytes()[:size])
    return to


def chunk_starts(path: Path) -> list[int]:
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    return [index.chunk_start_offset for index in summary.chunk_indexes]


def data_end(path: Path) -> int:
    """Where the last chunk's message indexes end."""
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    last = summary.chunk_indexes[-1]
    return last.chunk_start_offset + last.chunk_length + last.message_index_length


def resumed(directory: Path) -> int:
    """Fly what is left of a flight; returns the step that it was gone on with behind."""
    with recording(directory, CONFIGURATION, grants=True, resume=True) as run:
        saved = run.saved
        number = next((i for i, row in enumerate(ROWS) if row.step == saved), -1)
        assert run.checkpoint == (ROWS[number].states if saved >= 0 else [])
        on_disk = [step for step, _, _ in states_of_torn(run.bag.path)]
        assert on_disk == [row.step for row in ROWS[: number + 1] for _ in BIRDS]
        write(run, rest(run))
    return saved


def states_of_torn(path: Path) -> list[tuple[int, str, bytes]]:
    with BagReader(path) as bag:
        return [
            (int.from_bytes(data[28:36], "little"), topic, data)
            for topic, _, data in bag.messages()
            if topic.endswith("state")
        ]


@pytest.mark.slow
def test_a_flight_cut_off_anywhere_is_gone_on_with_and_no_bit_differs(
    tmp_path: Path, small_chunks: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "fsync", lambda fd: None)  # hundreds of bags that no power cut meets
    with recording(tmp_path / "whole", CONFIGURATION, grants=True) as run:
        write(run, ROWS[:-1])
        run.flush()
        write(run, ROWS[-1:])
    assert_undisturbed(tmp_path / "whole")
    path = recording_in(tmp_path / "whole")
    size, starts = path.stat().st_size, chunk_starts(path)
    chance = random.Random(3)
    end = data_end(path)
    every_byte = range(starts[-1] - 1, end + 30)  # of the last chunk, and the end of the data
    results: dict[int, dict[str, bytes]] = {}
    for cut in sorted({*every_byte, *(chance.randrange(size) for _ in range(150)), size}):
        directory = cut_copy(path, tmp_path / "cut", cut)
        saved = resumed(directory)
        # What was kept decides every byte of the rest, so outsiders need judge one of each only.
        result = {entry.name: entry.read_bytes() for entry in directory.iterdir()}
        if results.setdefault(saved, result) is result:
            assert_undisturbed(directory)
        assert result == results[saved]
        shutil.rmtree(directory)
    assert len(results) == len(starts) + 1 > 4
    assert {-1, ROWS[-2].step, ROWS[-1].step} <= results.keys()


def test_a_flight_in_many_parts_is_one_flight(tmp_path: Path) -> None:
    """Each part ends by `close`, as by Ctrl-C, after four rows."""
    directory = tmp_path / "bag"
    while True:
        with recording(directory, CONFIGURATION, grants=True, resume=True) as run:
            left = rest(run)
            if not left:
                break
            write(run, left[:4])
        with Run(directory) as part:
            assert part.bag.missing is None
    assert_undisturbed(directory)


def test_every_chunk_holds_whole_rows(tmp_path: Path, small_chunks: None) -> None:
    with recording(tmp_path / "bag", CONFIGURATION, grants=True, stages=True) as run:
        write(run, [with_stages(row) for row in ROWS])
    chunks = 0
    with recording_in(tmp_path / "bag").open("rb") as file:
        reader = StreamReader(file, emit_chunks=True)
        kinds = []
        for entry in reader.records:
            if type(entry).__name__ == "Channel" and not chunks:
                kinds.append(entry.topic.rpartition("/")[2])
            if isinstance(entry, Chunk):
                chunks += 1
                held = [kinds[message.channel_id - 1] for message in breakup_chunk(entry)]
                while held:
                    kind = held.pop(0)
                    if kind == "grant":
                        continue
                    row = [kind]
                    while row[-3:] != ["state"] * 3:
                        row.append(held.pop(0))
                    first = ["wing"] * 3 if row[0] == "wing" else ["stage"] * 24
                    assert row == [*first, "clock", "state", "state", "state"]
    assert chunks > 4


def test_a_row_that_does_not_come_to_its_end_leaves_nothing(tmp_path: Path) -> None:
    half = Row(ROWS[1].step, [], [], ROWS[1].time, ROWS[1].states[:2])
    with recording(tmp_path / "bag", CONFIGURATION, grants=True) as run:
        run.write_row(ROWS[0])
        with pytest.raises(ValueError, match="shorter"):
            run.write_row(half)
        run.flush()
        assert run.saved == 0
        write(run, ROWS[1:4])
        with pytest.raises(ValueError, match="shorter"):
            run.write_row(half)
    assert states_of(recording_in(tmp_path / "bag")) == STATES[: 4 * 3]


@pytest.mark.parametrize("by", ["recording", "bag", "limit", "close"])
def test_saved_is_the_last_row_on_disk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, by: str
) -> None:
    if by == "limit":
        monkeypatch.setitem(BagWriter.__init__.__kwdefaults__, "chunk_size", 1)
    with recording(tmp_path / "bag", CONFIGURATION, grants=True) as run:
        run.write_grant(grant(0))
        assert (run.saved, run.checkpoint) == (-1, [])
        before: tuple[int, list[bytes]] = (-1, [])
        for row in ROWS[:5]:
            run.write_row(row)
            if by != "limit":
                assert (run.saved, run.checkpoint) == before
            if by == "recording":
                run.flush()
            elif by == "bag":
                run.bag.flush()
            if by != "close":
                before = (row.step, row.states)
                assert (run.saved, run.checkpoint) == before
                with BagReader(tmp_path / "bag") as bag:  # what another process sees
                    assert list(bag.messages())[-1][2] == row.states[-1]
    assert (run.saved, run.checkpoint) == (ROWS[4].step, ROWS[4].states)


def test_a_row_that_was_put_on_disk_is_saved_though_another_follows(tmp_path: Path) -> None:
    with recording(tmp_path / "bag", CONFIGURATION, grants=True) as run:
        run.write_row(ROWS[0])
        run.bag.flush()
        run.write_row(ROWS[1])
        assert run.saved == 0


def test_a_row_that_the_disk_refuses_is_not_saved(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(fd: int, data: memoryview, offset: int) -> int:
        monkeypatch.undo()
        raise OSError(28, os.strerror(28))

    with recording(tmp_path / "bag", CONFIGURATION, grants=True) as run:
        run.write_row(ROWS[0])
        run.flush()
        run.write_row(ROWS[1])
        monkeypatch.setattr(os, "pwrite", full)
        with pytest.raises(RunFailed, match="No space left"):
            run.flush()
        assert run.saved == 0
        with pytest.raises(RunFailed, match="No space left"):
            run.write_row(ROWS[2])
        assert run.saved == 0
    assert run.saved == 0
    assert resumed(tmp_path / "bag") == 0  # once there is room again
    assert_undisturbed(tmp_path / "bag")


def test_a_bag_whose_chunks_end_within_rows_loses_no_more_than_the_half_row(
    tmp_path: Path, small_chunks: None
) -> None:
    """As `repair` writes bags: message by message."""
    path = recording_in(record(tmp_path / "whole", CONFIGURATION, grants=True))
    starts = chunk_starts(path)
    reached = set()
    for number, start in enumerate(starts):
        directory = cut_copy(path, tmp_path / f"cut{number}", start)
        held = states_of_torn(directory / "bag_0.mcap")
        whole = len(held) // 3
        assert resumed(directory) == (ROWS[whole - 1].step if whole else -1)
        reached.add(len(held) % 3)
        assert_undisturbed(directory)
    assert reached - {0}  # chunks did end within rows


def test_a_flight_that_has_grants_only_begins_with_its_first_row(tmp_path: Path) -> None:
    with recording(tmp_path / "bag", CONFIGURATION, grants=True) as run:
        run.write_grant(grant(0))
    with recording(tmp_path / "bag", CONFIGURATION, grants=True, resume=True) as run:
        assert (run.saved, run.checkpoint) == (-1, [])
        write(run, ROWS)
        run.flush()
        run.write_grant(grant(90))
    with recording(tmp_path / "bag", CONFIGURATION, grants=True, resume=True) as run:
        assert (run.saved, run.checkpoint) == (ROWS[-1].step, ROWS[-1].states)
        run.write_grant(grant(91))
    assert_undisturbed(tmp_path / "bag")
    with BagReader(tmp_path / "bag") as bag:
        grants = [(time, data) for _, time, data in bag.messages([topics.GRANT_TOPIC])]
    last = CONFIGURATION.stamp(ROWS[-1].step)
    assert grants[0] == (0, grant(0))
    assert grants[-2:] == [(last, grant(90)), (last, grant(91))]


def test_a_bag_that_was_laid_down_tells_what_is_flown_and_takes_the_flight(tmp_path: Path) -> None:
    lay_down(tmp_path / "bag", CONFIGURATION, grants=True, stages=False)
    assert [entry.name for entry in (tmp_path / "bag").iterdir()] == ["bag_0.mcap"]
    with Run(tmp_path / "bag") as run:
        assert run.configuration == CONFIGURATION
        assert run.missing is not None
        assert not has_stages(run.bag)
    with pytest.raises(FlockError, match="not empty"):
        lay_down(tmp_path / "bag", CONFIGURATION, grants=True, stages=False)
    assert resumed(tmp_path / "bag") == -1
    assert_undisturbed(tmp_path / "bag")


def test_a_bag_tells_whether_it_has_stages(tmp_path: Path) -> None:
    lay_down(tmp_path / "bag", CONFIGURATION, grants=True, stages=True)
    with BagReader(tmp_path / "bag") as bag:
        assert has_stages(bag)


@pytest.mark.parametrize("other", ["configuration", "stages", "grants", "version"])
def test_another_flight_is_not_gone_on_with(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, other: str
) -> None:
    path = flown(tmp_path / "bag", ROWS[:9])
    before = {entry.name: entry.read_bytes() for entry in path.parent.iterdir()}
    birds = 4 if other == "configuration" else 3
    configuration = FlockConfiguration(
        birds=birds, t_max=60.0, record_every=2, span_ratios=("2=1,1.05",)
    )
    if other == "version":
        monkeypatch.setattr(flight_bag, "__version__", "99.0")
    with (
        pytest.raises(FlockError, match="can't be continued: it was recorded with another") as told,
        recording(
            tmp_path / "bag",
            configuration,
            grants=other != "grants",
            stages=other == "stages",
            resume=True,
        ),
    ):
        pass
    assert "\n" not in str(told.value)
    assert {entry.name: entry.read_bytes() for entry in path.parent.iterdir()} == before


def test_a_bag_with_stages_is_not_gone_on_with_without(tmp_path: Path) -> None:
    lay_down(tmp_path / "bag", CONFIGURATION, grants=True, stages=True)
    with (
        pytest.raises(FlockError, match="can't be continued"),
        recording(tmp_path / "bag", CONFIGURATION, grants=True, resume=True),
    ):
        pass


def test_a_recorder_that_is_killed_again_and_again_records_the_whole_flight(
    tmp_path: Path,
) -> None:
    script = textwrap.dedent(
        """
        import sys
        from pathlib import Path
        from flock_sim.configuration.flock_configuration import FlockConfiguration
        from flock_sim.reference.integrator import Reference
        from flock_sim.recording.flight_writer import recording
        from flock_sim.launcher.reference_flight import row
        flown = FlockConfiguration(birds=2, t_max=5000.0, record_every=1)
        with recording(Path(sys.argv[1]), flown, grants=True, resume=True) as run:
            print(run.saved, flush=True)
            for recorded in Reference(flown).fly():
                if recorded.step > run.saved:
                    run.write_row(row(flown, recorded))
                    if recorded.step % 7 == 0:
                        run.flush()
                        print(run.saved, flush=True)
            if sys.argv[2] == "wait":
                sys.stdin.read()
        """
    )
    bag = tmp_path / "bag"
    told = -1
    for lines in (1, 40, 90):
        with subprocess.Popen(
            [sys.executable, "-c", script, bag, "wait"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        ) as child:
            assert child.stdout is not None
            first = int(child.stdout.readline())
            assert first >= told  # what was said to be saved was still there
            for _ in range(lines):
                told = int(child.stdout.readline())
            child.kill()  # somewhere further on
            told = max([told, *(int(line) for line in child.stdout if line.endswith("\n"))])
        assert child.returncode == -signal.SIGKILL
        if told >= 4000:  # a machine on which a kill takes long
            break
    subprocess.run([sys.executable, "-c", script, bag, "end"], check=True, capture_output=True)
    whole = FlockConfiguration(birds=2, t_max=5000.0, record_every=1)
    expected = [
        (recorded.step, bird, data)
        for recorded in Reference(whole).fly()
        for bird, data in enumerate(row_of(whole, recorded).states, start=1)
    ]
    assert states_of(recording_in(bag)) == expected
    with AnyReader([bag]) as other, Run(bag) as run:
        assert run.missing is None
        assert other.message_count == sum((run.bag.message_counts or {}).values())
