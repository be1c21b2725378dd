# SPDX-License-Identifier: Apache-2.0
"""A bag belongs to one process at a time, and stays until its replacement has begun."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from contextlib import ExitStack, nullcontext
from pathlib import Path

import pytest

from flock_sim.bag.directory import NEW_FILE
from flock_sim.commands import fly as fly_module
from flock_sim.commands import reference
from flock_sim.commands.flight_report import claim_output
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.console.arguments import run_tool
from flock_sim.errors import FlockError, RunFailed
from flock_sim.recording import output_directory as output_module
from flock_sim.recording.flight_writer import Recording, lay_down, recording
from flock_sim.recording.output_directory import own_bag, own_output
from flock_sim.recording.run import Run
from flock_tools.commands import repair
from flock_tools.experiments.sweep.directory import SweepDirectory
from support.flights import flown_rows, record
from support.tool_runs import error_of

CONFIGURATION = FlockConfiguration(birds=3, t_max=60.0, record_every=2)
ROWS = flown_rows(CONFIGURATION)
OTHER = FlockConfiguration(birds=2, t_max=20.0)


def tree(root: Path) -> dict[str, bytes]:
    """Return what is in a bag's directory; the space held back apart."""
    files = (path for path in sorted(root.rglob("*")) if path.is_file())
    return {str(path.relative_to(root)): path.read_bytes() for path in files}


def begun(directory: Path, owned: ExitStack, *, orphan: bool = False) -> Recording:
    """Return a recording in mid-flight; `orphan`: whoever owned it was killed."""
    if not orphan:
        owned.enter_context(own_output(directory, force=False))
    run = owned.enter_context(recording(directory, CONFIGURATION, grants=True))
    for row in ROWS[:9]:
        run.write_row(row)
    run.flush()
    return run


@pytest.mark.parametrize("orphan", [False, True])
def test_no_tool_replaces_a_bag_that_is_recorded_to(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    orphan: bool,
) -> None:
    monkeypatch.setattr(output_module, "ORPHAN_TIMEOUT", 0.0)
    live = tmp_path / "live"
    torn = record(tmp_path / "torn", CONFIGURATION)
    (torn / "metadata.yaml").unlink()
    flock = ("--birds", "2", "--t-max", "20")
    with ExitStack() as owned:
        run = begun(live, owned, orphan=orphan)
        before = tree(live)
        where = ("--output", str(live), "--force")
        for tool, arguments in (
            (reference.tool, (*flock, *where)),
            (fly_module.tool, (*flock, *where)),
            (fly_module.tool, ("--resume", str(live))),
            (repair.tool, (str(torn), *where)),
        ):
            error = error_of(tool, capsys, *arguments)
            assert f"another process is recording to {live}" in error
            assert tree(live) == before
        for row in ROWS[9:]:
            run.write_row(row)
    with Run(live) as whole:
        assert whole.missing is None
        assert sum(1 for _ in whole.states()) == 3 * len(ROWS)


def test_a_recorder_whose_owner_was_killed_is_waited_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with ExitStack() as owned:
        begun(tmp_path / "live", owned, orphan=True)
        monkeypatch.setattr(output_module.time, "sleep", lambda seconds: owned.close())
        with own_bag(tmp_path / "live"), Run(tmp_path / "live") as ended:
            assert ended.bag.missing is None


def test_a_sweep_is_not_replaced_while_a_flight_of_it_is_flown(tmp_path: Path) -> None:
    output = tmp_path / "sweep"
    with SweepDirectory(output).held("one", False):
        pass
    record(output / "flight_01", CONFIGURATION)
    with ExitStack() as owned:
        begun(output / "flight_02", owned)
        before = tree(output)
        with (
            pytest.raises(FlockError, match=r"another process is recording to .*flight_02"),
            SweepDirectory(output).held("two", True),
        ):
            pass
        assert tree(output) == before


def test_a_sweep_stays_until_the_one_that_replaces_it_has_begun(tmp_path: Path) -> None:
    output = tmp_path / "sweep"
    with SweepDirectory(output).held("one", False):
        record(output / "flight_01", CONFIGURATION)
    before = tree(output)

    def replaced(fail: bool) -> None:
        with SweepDirectory(output).held("two", True):
            assert not (output / "flight_01").exists()
            if fail:
                lay_down(output / "flight_01", OTHER, grants=True, stages=False)
                raise RunFailed("there is no RMW")
            record(output / "flight_01", OTHER)

    with pytest.raises(RunFailed):
        replaced(fail=True)
    assert tree(output) == before
    replaced(fail=False)
    assert (output / "sweep.yaml").read_text() == "two"
    with Run(output / "flight_01") as run:
        assert run.configuration == OTHER
    assert sorted(entry.name for entry in output.iterdir()) == ["flight_01", "sweep.yaml"]


def test_what_a_kill_left_of_replacing_a_sweep_is_settled_by_the_next(tmp_path: Path) -> None:
    output = tmp_path / "sweep"
    with SweepDirectory(output).held("one", False):
        for number in (1, 2):
            record(output / f"flight_{number:02d}", CONFIGURATION)
    before = tree(output)
    (output / ".replaced").mkdir()
    for name in ("flight_01", "flight_02", "sweep.yaml"):  # in the order of putting aside
        (output / name).rename(output / ".replaced" / name)
        with SweepDirectory(output).held("one", False):
            assert tree(output) == before
        (output / ".replaced").mkdir()
        for other in ("flight_01", "flight_02", "sweep.yaml"):
            if other <= name:
                (output / other).rename(output / ".replaced" / other)


def old_and_new(tmp_path: Path) -> tuple[Path, dict[str, bytes]]:
    bag = record(tmp_path / "bag", OTHER)
    (bag / "formation.png").write_bytes(b"a picture")
    return bag, tree(bag)


def test_a_bag_stays_until_the_first_row_of_the_next_is_on_disk(tmp_path: Path) -> None:
    bag, before = old_and_new(tmp_path)
    other = bag / "._bag_0.mcap"  # as a Mac leaves it beside a file
    other.write_bytes(b"\0\5\x16\7")
    with (
        own_output(bag, force=True) as output,
        recording(bag, CONFIGURATION, grants=True, replace=output.replaces) as run,
    ):
        run.write_row(ROWS[0])
        there = tree(bag)
        assert {name: there[name] for name in before} == before
        run.flush()
        assert run.saved == 0
        assert not (bag / "metadata.yaml").exists()  # it is not complete
        with Run(bag) as flown:
            assert flown.configuration == CONFIGURATION
        for row in ROWS[1:]:
            run.write_row(row)
    assert sorted(tree(bag)) == ["bag_0.mcap", "metadata.yaml"]
    with Run(bag) as flown:
        assert flown.missing is None
        assert sum(1 for _ in flown.states()) == 3 * len(ROWS)


@pytest.mark.parametrize("end", ["interrupted", "killed", "nothing recorded", "recorder stopped"])
def test_a_bag_that_never_began_replaces_nothing(tmp_path: Path, end: str) -> None:
    bag, before = old_and_new(tmp_path)

    def begin() -> None:
        with own_output(bag, force=True) as output:
            if end == "killed":  # the recorder, and then the owner closes
                lay_down(bag, CONFIGURATION, grants=True, stages=False, replace=output.replaces)
                assert (bag / NEW_FILE).exists()
                return
            if end == "recorder stopped":  # as under `fly`
                lay_down(bag, CONFIGURATION, grants=True, stages=False, replace=output.replaces)
                with recording(bag, CONFIGURATION, grants=True, resume=True) as run:
                    assert {name: tree(bag)[name] for name in before} == before
                    run.write_grant(b"leave")
                return
            with recording(bag, CONFIGURATION, grants=True, replace=output.replaces) as run:
                if end == "interrupted":
                    run.write_grant(b"leave")
                    raise KeyboardInterrupt

    if end == "interrupted":
        with pytest.raises(KeyboardInterrupt):
            begin()
    else:
        begin()
    assert tree(bag) == before


def test_what_a_kill_left_of_a_bag_that_never_began_is_removed(tmp_path: Path) -> None:
    bag, before = old_and_new(tmp_path)
    lay_down(bag, CONFIGURATION, grants=True, stages=False, replace=True)
    with own_bag(bag):  # as by --resume
        assert tree(bag) == before


def test_fly_keeps_the_old_bag_where_the_flight_can_not_begin(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    bag, before = old_and_new(tmp_path)

    def no_rmw(plan: object) -> None:
        raise FlockError("there is no RMW")

    monkeypatch.setattr(fly_module, "on_ros", lambda network: nullcontext())
    monkeypatch.setattr(fly_module, "fly", no_rmw)
    assert run_tool(fly_module.tool, ["--birds", "3", "--output", str(bag), "--force"]) == 2
    assert "there is no RMW" in capsys.readouterr().err
    assert tree(bag) == before


def test_fly_makes_no_directory_before_settings_are_checked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("RMW_IMPLEMENTATION", "rmw_of_nobody")
    assert "rmw_of_nobody" in error_of(fly_module.tool, capsys, "--birds", "3")
    assert not list(tmp_path.iterdir())


def test_reference_and_repair_keep_the_old_bag_where_the_disk_is_full(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    bag, before = old_and_new(tmp_path)
    torn = record(tmp_path / "torn", CONFIGURATION)
    (torn / "metadata.yaml").unlink()
    hurt = tree(torn)
    pwrite = os.pwrite

    def full(fd: int, data: bytes, offset: int) -> int:
        if offset:  # the head has room
            raise OSError(28, "No space left on device")
        return pwrite(fd, data, offset)

    monkeypatch.setattr(os, "pwrite", full)
    for tool, arguments in (
        (reference.tool, ["--birds", "2", "--t-max", "20", "--output", str(bag)]),
        (repair.tool, [str(torn), "--output", str(bag)]),
        (repair.tool, [str(torn), "--output", str(torn)]),  # the bag itself
    ):
        assert run_tool(tool, [*arguments, "--force"]) == 1
        assert "No space left" in capsys.readouterr().err
        assert (tree(bag), tree(torn)) == (before, hurt)


def unlink(bag: Path) -> None:
    (bag / "bag_0.mcap").unlink()


def move_file(bag: Path) -> None:
    (bag / "bag_0.mcap").rename(bag.parent / "elsewhere.mcap")


def move_directory(bag: Path) -> None:
    bag.rename(bag.parent / "elsewhere")


def remove_directory(bag: Path) -> None:
    shutil.rmtree(bag)


def replace_by_another(bag: Path) -> None:
    shutil.rmtree(bag)
    other = record(bag.parent / "other", OTHER)
    other.rename(bag)
    (bag / "other_0.mcap").rename(bag / "bag_0.mcap")


def truncate(bag: Path) -> None:
    os.truncate(bag / "bag_0.mcap", (bag / "bag_0.mcap").stat().st_size - 1)


def copy_over(bag: Path) -> None:
    size = (bag / "bag_0.mcap").stat().st_size
    (bag / "bag_0.mcap").write_bytes(bytes(2 * size))


def overwrite(bag: Path) -> None:
    with (bag / "bag_0.mcap").open("r+b") as file:
        file.seek(1000)
        file.write(b"thesis")
    os.utime(bag / "bag_0.mcap", ns=(1, 1))  # whatever the file system's clock makes of it


ATTACKS = (
    unlink,
    move_file,
    move_directory,
    remove_directory,
    replace_by_another,
    truncate,
    copy_over,
    overwrite,
)


@pytest.mark.parametrize("attack", ATTACKS)
@pytest.mark.parametrize("noticed", ["at the next row", "by a look", "at the end"])
def test_a_recorder_that_has_lost_its_file_says_so_and_completes_nothing(
    tmp_path: Path, attack: Callable[[Path], None], noticed: str
) -> None:
    bag = tmp_path / "bag"
    run = Recording(bag, CONFIGURATION, grants=False)
    for row in ROWS[:9]:
        run.write_row(row)
    run.flush()
    attack(bag)
    after = tree(tmp_path)
    if noticed == "at the next row":
        run.write_row(ROWS[9])
    notice = {"by a look": run.bag.check, "at the end": run.close}.get(noticed, run.flush)
    with pytest.raises(RunFailed, match=r"recording to .*bag_0\.mcap failed: ") as told:
        notice()
    assert "\n" not in str(told.value)
    run.close()
    assert {name: data for name, data in tree(tmp_path).items() if ".reserve" not in name} == {
        name: data for name, data in after.items() if ".reserve" not in name
    }


def test_a_write_that_no_clock_tells_is_found_at_the_end(tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    run = Recording(bag, CONFIGURATION, grants=False)
    run.write_row(ROWS[0])
    run.flush()
    status = (bag / "bag_0.mcap").stat()
    overwrite(bag)
    os.utime(bag / "bag_0.mcap", ns=(status.st_atime_ns, status.st_mtime_ns))
    with pytest.raises(RunFailed, match="another process has written to it"):
        run.close()
    assert not (bag / "metadata.yaml").exists()


def test_a_bag_that_was_only_touched_is_recorded_to_its_end(tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    with recording(bag, CONFIGURATION, grants=False) as run:
        for row in ROWS:
            run.write_row(row)
            run.flush()
            (bag / "bag_0.mcap").touch()
    with Run(bag) as whole:
        assert whole.missing is None


def test_a_directory_that_was_replaced_tells_nothing_of_the_flight(tmp_path: Path) -> None:
    with own_output(tmp_path / "bag", force=False) as output:
        (tmp_path / "bag" / "x").touch()
        output.check()
        (tmp_path / "bag").rename(tmp_path / "elsewhere")
        record(tmp_path / "bag", OTHER)
        with pytest.raises(RunFailed, match="was moved or removed"):
            output.check()


def test_flights_that_are_started_together_have_a_bag_each(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with ExitStack() as owned:
        outputs = [owned.enter_context(claim_output(None, False, "fly")) for _ in range(6)]
        assert len({output.path for output in outputs}) == 6
        assert all(output.path.is_dir() for output in outputs)
