# SPDX-License-Identifier: Apache-2.0
"""Only what nobody holds is removed from shared memory."""

from __future__ import annotations

import fcntl
import mmap
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from subprocess import PIPE

import pytest

from flock_sim import shared_memory
from flock_sim.shared_memory import YOUNGEST, remove_orphans


@pytest.fixture(autouse=True)
def held_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Lock files that a test makes are as old as they need to be."""
    monkeypatch.setattr(shared_memory, "UNHELD", -1.0)


@pytest.fixture
def memory(tmp_path: Path) -> Path:
    return tmp_path


def segment(memory: Path, name: str, mutex: bool = False) -> set[str]:
    names = {f"fastrtps_{name}", f"fastrtps_{name}_el"}
    names |= {f"sem.fastrtps_{name}_mutex"} if mutex else set()
    for file in names:
        (memory / file).touch()
    return names


def test_segments_and_ports_that_nobody_holds_are_removed(memory: Path) -> None:
    segment(memory, "0123456789abcdef")
    segment(memory, "port7411", mutex=True)
    remove_orphans(memory)
    assert list(memory.iterdir()) == []


@pytest.mark.parametrize("lock", [fcntl.LOCK_EX, fcntl.LOCK_SH])
def test_a_segment_that_is_held_stays(memory: Path, lock: int) -> None:
    held = segment(memory, "0123456789abcdef") | segment(memory, "port7411", mutex=True)
    (memory / "fastrtps_port7411_sl").touch()
    held.add("fastrtps_port7411_sl")
    segment(memory, "fedcba9876543210")
    with (
        (memory / "fastrtps_0123456789abcdef_el").open("rb") as one,
        (memory / "fastrtps_port7411_sl").open("rb") as other,
    ):
        fcntl.flock(one, lock)
        fcntl.flock(other, lock)
        remove_orphans(memory)
    assert {path.name for path in memory.iterdir()} == held


HOLD = """\
import mmap, sys
file = open(sys.argv[1], "r+b")
held = mmap.mmap(file.fileno(), 0)
print("mapped", flush=True)
sys.stdin.read()
"""


@contextmanager
def mapped(file: Path) -> Iterator[None]:
    """Have another process map `file`."""
    file.write_bytes(bytes(mmap.PAGESIZE))
    command = [sys.executable, "-c", HOLD, str(file)]
    with subprocess.Popen(command, stdin=PIPE, stdout=PIPE) as other:
        assert other.stdin
        assert other.stdout
        assert other.stdout.readline() == b"mapped\n"
        yield
        other.stdin.close()


@pytest.mark.parametrize("file", ["fastrtps_port7011", "sem.fastrtps_port7011_mutex"])
def test_a_port_that_is_no_domains_stays_while_anybody_has_it_mapped(
    memory: Path, file: str
) -> None:
    # Its owner has ended and given up its lock; whoever has it mapped removes it, or takes it over.
    files = segment(memory, "port7011", mutex=True)
    with mapped(memory / file):
        remove_orphans(memory)
        assert {path.name for path in memory.iterdir()} == files
    remove_orphans(memory)
    assert list(memory.iterdir()) == []


@pytest.mark.parametrize("name", ["port8413", "0123456789abcdef"])
def test_what_only_our_own_flight_can_have_is_removed_all_the_same(
    memory: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", "4")
    segment(memory, name)
    with mapped(memory / f"fastrtps_{name}"):
        remove_orphans(memory)
    assert list(memory.iterdir()) == []


def test_one_without_a_lock_that_is_in_use_stays_as_long_as_it_may_be_in_the_making(
    memory: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", "0")
    port = memory / "fastrtps_port7413"
    with mapped(port):
        born = port.stat().st_ctime
        monkeypatch.setattr(time, "time", lambda: born + 0.9 * YOUNGEST)
        remove_orphans(memory)
        assert port.exists()
        monkeypatch.setattr(time, "time", lambda: born + 1.1 * YOUNGEST)
        remove_orphans(memory)
        assert not port.exists()


def test_one_without_a_lock_that_nobody_uses_is_removed_at_once(memory: Path) -> None:
    # Made by who wrote to somebody who was dead by then.
    (memory / "fastrtps_port7413").touch()
    remove_orphans(memory)
    assert list(memory.iterdir()) == []


def test_what_is_not_fast_ddss_stays(memory: Path) -> None:
    names = {
        "lttng-ust-wait-8",
        "somebody_el",
        "fastrtps_notes",
        "sem.mine",
        "psm_0123456789abcdef",
    }
    for name in names:
        (memory / name).touch()
    remove_orphans(memory)
    assert {path.name for path in memory.iterdir()} == names


def test_a_machine_without_shared_memory_is_no_error(memory: Path) -> None:
    remove_orphans(memory / "missing")
