# SPDX-License-Identifier: Apache-2.0
"""A process has one DDS participant, and leaves it without a deadlock."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

import pytest
import rclpy
from rclpy.context import Context
from rclpy.node import Node

from flock_sim.ros import fastdds_shutdown
from flock_sim.ros.fastdds_shutdown import stop_discovery
from flock_sim.ros.log import ros_context
from flock_sim.ros.process import Process, executing, run_node
from flock_sim.ros.settings_check import shared_memory, udp_sockets
from support.terminal import own_domain, ports
from support.visitor import tell_fast_dds

DEADLINE = 60.0
"""Time, in s, in which two nodes find each other."""


def node_of(context: Context, name: str) -> Node:
    return Node(name, context=context, start_parameter_services=False, enable_rosout=False)


EVERYBODYS = "/parameter_events"
"""A topic on which every node publishes."""


def wait_for_publishers(count: int, node: Node) -> None:
    deadline = time.monotonic() + DEADLINE
    while (found := node.count_publishers(EVERYBODYS)) != count:
        assert time.monotonic() < deadline, f"{found} nodes found, not {count}"
        time.sleep(0.02)


def test_who_is_about_to_leave_is_told_of_nobody_any_more(context: Context) -> None:
    # Told, by a thread of its own, it could wait for itself for ever: so it is on this that the
    # mend of Fast DDS rests. It learns of neither ends nor beginnings.
    others = [ros_context() for _ in range(2)]
    one = node_of(context, "one")
    two, three = node_of(others[0], "two"), None
    try:
        wait_for_publishers(2, one)
        wait_for_publishers(2, two)
        stop_discovery(context)  # of all participants on this domain: two is as deaf
        three = node_of(others[1], "three")
        wait_for_publishers(3, three)
        assert one.count_publishers(EVERYBODYS) == 2
        assert two.count_publishers(EVERYBODYS) == 2
    finally:
        for node in filter(None, (three, two, one)):
            node.destroy_node()
        for other in others:
            rclpy.try_shutdown(context=other)


def test_an_executor_leaves_before_its_nodes_end(
    context: Context, monkeypatch: pytest.MonkeyPatch
) -> None:
    order: list[str] = []

    class Watched(Node):
        def destroy_node(self) -> None:
            order.append("node")
            super().destroy_node()

    monkeypatch.setattr(
        fastdds_shutdown, "stop_discovery", lambda context: order.append("discovery")
    )
    with executing("events", context) as executor:
        for name in ("one", "two"):
            executor.add_node(Watched(name, context=context))
    assert order == ["discovery", "node", "node"]


def test_a_fast_dds_that_is_not_known_is_left_alone(
    context: Context, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fastdds_shutdown, "fast_dds", lambda: None)
    stop_discovery(context)
    one = node_of(context, "one")
    one.destroy_node()


@pytest.mark.parametrize(
    "path",
    [
        "/a/lib/libfastrtps.so.2.14",
        "/two words/and  more/libfastrtps.so",
        "/Bjørn's flöck/lib/libfastrtps.so.2.14.5",
        "/not\udcfcutf-8/libfastrtps.so.2.14",
    ],
)
@pytest.mark.parametrize("suffix", ["", " (deleted)"])
def test_fast_dds_is_found_wherever_it_is_kept(path: str, suffix: str) -> None:
    mapped = "7f0000000000-7f0000001000 r-xp 00000000 fe:01 123456"
    maps = (
        f"{mapped}     /usr/lib/libfastrtps.so.d/other.so\n{mapped} \n"
        f"{mapped}     {path}{suffix}\n{mapped}     [stack]\n"
    )
    assert fastdds_shutdown.library_in(os.fsencode(maps)) == path


def test_fast_dds_is_not_found_where_it_is_not_used() -> None:
    assert (
        fastdds_shutdown.library_in(b"7f00-7f01 r-xp 00000000 fe:01 1  /usr/lib/libc.so.6\n")
        is None
    )


def test_a_process_keeps_the_participant_with_which_it_read_its_parameters(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path / "log"))
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    # As they were: the process of the test goes on.
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    used: list[set[int]] = []
    names: list[list[str]] = []

    def work(process: Process) -> None:
        used.append(ports(os.getpid()))
        with executing("single", process.context) as executor:
            node = Node("bird", context=process.context, enable_rosout=False)
            executor.add_node(node)
            process.settle()
            names.append(node.get_node_names())
            used.append(ports(os.getpid()))
            assert not shared_memory()
            assert {address for address, _ in udp_sockets()} == {"127.0.0.1"}

    try:
        with own_domain() as domain:
            monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
            tell_fast_dds(monkeypatch)
            status = run_node("bird", "A bird.", "", work)(["--ros-args", "-p", "birds:=3"])
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    assert status == 0
    at_first, in_the_end = used
    assert at_first
    assert at_first <= in_the_end
    assert names == [["_bird_parameters", "bird"]]
