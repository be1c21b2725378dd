# SPDX-License-Identifier: Apache-2.0
"""Faults in flight end it soon, with one line, and leave a readable bag.

The terminal checks at the end of every test that no process, shared memory or temporary file
remains.
"""

from __future__ import annotations

import os
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from rosbags.highlevel import AnyReader

from flock_sim.errors import FlockError
from flock_sim.recording.run import Run
from support.terminal import POLL, Job, Terminal

BIRD = "flock_sim.nodes.bird_process"
RECORDER = "flock_sim.nodes.recorder_process"

LONG = ("--birds", 3, "--t-max", 1e8, "--record-every", 10)
"""More than any test waits for."""

SOON = 30.0
"""Time, in s, within which a flight ends when it is told to: half of what one that hangs is waited
for, and many times what a flight takes on a machine that is busy with other work."""


def in_flight(terminal: Terminal, *how: object) -> Job:
    """Start a long flight, and wait until some of it is on disk."""
    job = terminal.start("fly", *LONG, *how, "--output", "bag")
    job.until(lambda: last_step(terminal.directory / "bag") > 0)
    return job


def last_step(bag: Path) -> int:
    """The last step that is on disk; -1 for none."""
    try:
        return Run(bag).at().step
    except FlockError:
        return -1


def assert_readable(terminal: Terminal, *, complete: bool) -> None:
    """What was flown is measured; a bag that is complete is so for others too."""
    bag = terminal.directory / "bag"
    done = terminal.well("metrics", bag, "--json")
    assert done.json["steps"] > 0
    assert (bag / "metadata.yaml").exists() == complete
    assert ("is not complete" in done.stderr) != complete
    if complete:
        states = 0
        with AnyReader([bag]) as reader:
            for connection, _, raw in reader.messages():
                reader.deserialize(raw, connection.msgtype)
                states += connection.topic.endswith("/state")
        assert states == 3 * (done.json["steps"] // 10 + 1)


def test_ctrl_c_ends_a_flight_in_order(terminal: Terminal) -> None:
    job = in_flight(terminal, "--processes", 3)
    job.interrupt()
    done = job.wait(within=SOON)
    assert done.status == 130
    assert done.stdout == ""
    assert done.stderr.splitlines()[-1] == "stopped"
    assert "Traceback" not in done.stderr
    assert "error" not in done.stderr
    assert terminal.processes() == []
    assert_readable(terminal, complete=True)


def test_an_interrupt_of_fly_alone_ends_the_flight_too(terminal: Terminal) -> None:
    job = in_flight(terminal)
    job.send(signal.SIGINT)
    assert job.wait(within=SOON).status == 130
    assert_readable(terminal, complete=True)


def test_a_polite_kill_ends_a_flight_in_order(terminal: Terminal) -> None:
    job = in_flight(terminal, "--executor", "single")
    job.send(signal.SIGTERM)
    done = job.wait(within=SOON)
    assert done.status == 143
    assert "Traceback" not in done.stderr
    assert_readable(terminal, complete=True)


def test_ctrl_c_while_a_flight_is_starting_says_no_more_than_that(terminal: Terminal) -> None:
    job = terminal.start("fly", *LONG, "--processes", 3, "--output", "bag")
    job.until(lambda: job.workers(BIRD))
    job.interrupt()
    done = job.wait(within=SOON)
    assert done.status == 130
    assert "Traceback" not in done.stderr


def test_ctrl_c_ends_a_reference_flight_with_a_bag_that_is_complete(terminal: Terminal) -> None:
    job = terminal.start("reference", *LONG, "--output", "bag")
    job.until(lambda: last_step(terminal.directory / "bag") > 0)
    job.interrupt()
    assert job.wait(within=SOON).status == 130
    assert_readable(terminal, complete=True)


def test_fly_names_the_birds_that_do_not_come_up_and_gives_up(terminal: Terminal) -> None:
    flight = ("--birds", 4, "--processes", 2, "--t-max", 100, "--timeout", 8, "--output", "bag")
    job = terminal.start("fly", *flight)
    job.until_said("recording to")
    pid = job.until(lambda: [pid for pid in job.workers(BIRD) if is_of(pid, [3, 4])])[0]
    os.kill(pid, signal.SIGSTOP)
    job.until_said("waiting for ", within=SOON)
    said = job.stderr.splitlines()[-1]
    assert "bird_03, bird_04" in said
    done = job.wait()
    assert done.status == 1
    assert "no progress for 8 s" in done.error
    assert "bird_03, bird_04" in done.error
    assert "timeout" in done.error


def is_of(pid: int, birds: list[int]) -> bool:
    """Whether a worker flies these birds, by what its title calls it."""
    first, last = birds[0], birds[-1]
    name = f"bird-{first}" if first == last else f"birds-{first}..{last}"
    title = Path(f"/proc/{pid}/cmdline").read_text(encoding="utf-8").rstrip("\0 ")
    return title == f"{BIRD}:{name}"


def test_a_worker_that_is_killed_is_named(terminal: Terminal) -> None:
    job = in_flight(terminal, "--processes", 2, "--no-respawn")
    (pid,) = [pid for pid in job.workers(BIRD) if is_of(pid, [2, 3])]
    os.kill(pid, signal.SIGKILL)
    done = job.wait(within=SOON)
    assert done.status == 1
    assert done.error == "error: the process of birds 2..3 was killed by SIGKILL"
    assert_readable(terminal, complete=True)


def test_a_recorder_that_is_killed_is_named_and_what_it_wrote_is_read(terminal: Terminal) -> None:
    job = in_flight(terminal, "--no-respawn")
    (pid,) = job.workers(RECORDER)
    safe = last_step(terminal.directory / "bag")
    os.kill(pid, signal.SIGKILL)
    done = job.wait(within=SOON)
    assert done.status == 1
    assert done.error == "error: the recorder was killed by SIGKILL"
    assert_readable(terminal, complete=False)
    assert last_step(terminal.directory / "bag") >= safe


@pytest.mark.slow
def test_a_worker_that_hangs_in_mid_flight_is_named(terminal: Terminal) -> None:
    job = in_flight(terminal, "--processes", 3, "--timeout", 10)
    (pid,) = [pid for pid in job.workers(BIRD) if is_of(pid, [3])]
    os.kill(pid, signal.SIGSTOP)
    done = job.wait()
    assert done.status == 1
    assert "no progress for 10 s" in done.error
    assert "bird_03" in done.error
    assert_readable(terminal, complete=True)


def test_the_processes_of_a_flight_do_not_outlive_it(terminal: Terminal) -> None:
    job = in_flight(terminal, "--processes", 2)
    assert len(terminal.processes()) == 5  # fly, fork server, recorder and two of birds
    job.send(signal.SIGKILL)
    job.wait(within=SOON)
    deadline = time.monotonic() + SOON
    while terminal.processes():
        assert time.monotonic() < deadline, terminal.left_behind()
        terminal.look()
        time.sleep(0.02)
    assert_readable(terminal, complete=True)


@pytest.fixture
def small_disk(terminal: Terminal) -> Iterator[Path]:
    """A file system of 2 MiB of its own."""
    if os.geteuid() != 0:
        pytest.skip("only root can mount a small file system")
    disk = terminal.directory / "disk"
    disk.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=2m", "tmpfs", str(disk)]
    done = subprocess.run(mount, capture_output=True, check=False)
    if done.returncode:
        pytest.skip(f"this machine does not mount: {done.stderr.decode().strip()}")
    try:
        yield disk
    finally:
        subprocess.run(["umount", disk], check=True)


@pytest.mark.parametrize("tool", ["fly", "reference"])
def test_a_disk_that_is_full_ends_a_flight_with_what_was_flown(
    terminal: Terminal, small_disk: Path, tool: str
) -> None:
    members = ",".join(f"{0.9 + 0.001 * k:.3f}" for k in range(200))
    flock = ("--birds", 3, "--span-ratio", f"2={members}", "--record-every", 1, "--t-max", 1e6)
    done = terminal.run(tool, *flock, "--output", small_disk / "bag", "--json")
    assert done.status == 1
    assert "Traceback" not in done.stderr
    # First why, by who met it; then, where that was another process, that it has ended.
    why, *ended = [line for line in done.stderr.splitlines() if line.startswith("error: ")]
    assert "No space left on device" in why
    assert ended in ([], ["error: the recorder ended with status 1"])
    assert done.stdout == ""
    metrics = terminal.well("metrics", small_disk / "bag", "--json").json
    assert metrics["steps"] > 0
    assert metrics["members"] == 200
    assert (small_disk / "bag" / "metadata.yaml").exists()


def write_into(path: Path) -> None:
    """Overwrite a few bytes of a file, as a process that is not the recorder."""
    with path.open("r+b") as file:
        file.seek(2000)
        file.write(b"thesis")


@pytest.mark.parametrize("how", ["removed", "written to"])
def test_a_recorder_that_loses_its_file_ends_the_flight(terminal: Terminal, how: str) -> None:
    job = in_flight(terminal)
    bag = terminal.directory / "bag"
    refused = terminal.run("reference", "--birds", 2, "--output", "bag", "--force")
    assert refused.status == 2
    assert "another process is recording to bag" in refused.error
    assert job.running
    if how == "removed":
        (bag / "bag_0.mcap").unlink()
    else:
        # The clock of a file system is too coarse to show one write just after one of the recorder.
        deadline = time.monotonic() + SOON
        while job.running and time.monotonic() < deadline:
            write_into(bag / "bag_0.mcap")
            time.sleep(POLL)
    done = job.wait(SOON)
    assert (done.status, done.stdout) == (1, "")
    errors = [line for line in done.stderr.splitlines() if line.startswith("error: ")]
    words = "it was removed or moved" if how == "removed" else "another process has written to it"
    assert errors[0].startswith("error: recording to ")
    assert words in errors[0]
    assert errors[1:] == ["error: the recorder ended with status 1"]
    assert not (bag / "metadata.yaml").exists()
