# SPDX-License-Identifier: Apache-2.0
"""Flights use the loopback device alone, and other settings are refused."""

from __future__ import annotations

import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from rclpy.context import Context

from flock_sim.ros.discovery import FIRST_PORT, PORTS, is_fast_dds_3
from flock_sim.ros.settings_check import udp_sockets
from support.bags import assert_begins_as, last_step
from support.terminal import DEADLINE, Terminal, ports

BIRDS = 4
PROCESSES = 3


@pytest.fixture
def open_socket(terminal: Terminal) -> Iterator[int]:
    """A socket on every network, as Fast DDS has where it has not taken what it was told.

    It is on the last port of the terminal's domain, where no tool will want to be.
    """
    domain = int(terminal.environment["ROS_DOMAIN_ID"])
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as opened:
        opened.bind(("0.0.0.0", FIRST_PORT + PORTS * (domain + 1) - 1))
        yield opened.fileno()


@pytest.mark.parametrize(
    "words",
    [
        ("fly", "--birds", 2, "--t-max", 10, "--no-record"),
        ("clock", "--ros-args", "-p", "birds:=2"),
        ("bird", "--ros-args", "-p", "birds:=2", "-p", "index:=1"),
        ("recorder", "--ros-args", "-p", "birds:=2", "-p", "output:=bag"),
        ("play", "flown"),
        ("watch", "--once"),
        ("view",),
    ],
    ids=lambda words: words[0],
)
def test_a_tool_that_others_could_reach_is_refused(
    terminal: Terminal, open_socket: int, words: tuple[object, ...]
) -> None:
    if words[0] == "play":
        terminal.well("reference", "--birds", 1, "--t-max", 10, "--output", "flown")
    tool, *arguments = words
    done = terminal.start(str(tool), *arguments, pass_fds=(open_socket,)).wait()
    assert done.status == 2, done.stderr
    assert "Fast DDS listens on 0.0.0.0, not on 127.0.0.1 alone" in done.error
    assert not (terminal.directory / "bag").exists()


@pytest.mark.slow
def test_all_processes_of_a_flight_are_on_loopback_alone(terminal: Terminal) -> None:
    flock = ("--birds", BIRDS, "--record-every", 10)
    job = terminal.start(
        "fly", *flock, "--t-max", 1e6, "--processes", PROCESSES, "--output", "flown"
    )
    at_work = job.until(
        lambda: (
            (found := [pid for pid in terminal.processes() if ports(pid)])
            and len(found) == PROCESSES + 2  # clock and recorder
            and last_step(terminal.directory / "flown") >= 100
            and found
        )
    )
    addresses = {pid: {address for address, _ in udp_sockets(pid)} for pid in at_work}
    terminal.look()  # at their shared memory: there may be none
    job.interrupt()
    assert job.wait().status == 130
    assert list(addresses.values()) == [{"127.0.0.1"}] * len(at_work)
    end = last_step(terminal.directory / "flown")
    terminal.well("reference", *flock, "--t-max", end + 1000, "--output", "reference")
    states = assert_begins_as(terminal.directory / "flown", terminal.directory / "reference")
    assert states >= BIRDS * (end // 10 + 1)


def test_the_version_of_fast_dds_is_that_of_the_one_in_use(context: Context) -> None:
    maps = Path("/proc/self/maps").read_text(encoding="utf-8")
    in_use = ("/libfastrtps.so" in maps, "/libfastdds.so" in maps)
    assert in_use == (not is_fast_dds_3(), is_fast_dds_3())


IN_USE_BEFORE = """
import rclpy
from flock_sim.ros.fastdds_shutdown import leave
from flock_tools.testing import fly
rclpy.init()
node = rclpy.create_node("before")
try:
    fly(birds=1, t_max=10)
finally:
    leave(node.context, [node])
    rclpy.shutdown()
"""


def test_a_process_in_which_ros_was_in_use_with_other_settings_is_refused(
    terminal: Terminal,
) -> None:
    # Fast DDS reads its settings once; this participant is open to all, and a flight's would be.
    done = subprocess.run(
        [sys.executable, "-c", IN_USE_BEFORE],
        capture_output=True,
        text=True,
        env={**terminal.environment, "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"},
        cwd=terminal.directory,
        timeout=DEADLINE,
    )
    assert done.returncode == 1
    assert "FlockError: Fast DDS listens on 0.0.0.0" in done.stderr
