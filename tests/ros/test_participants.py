# SPDX-License-Identifier: Apache-2.0
"""A process has one DDS participant, and takes its turn at making and at ending it."""

from __future__ import annotations

import os
import signal
import socket
import threading
import time
from pathlib import Path

import pytest
from rclpy.context import Context
from rclpy.node import Node

from flock_sim.claims import claimed
from flock_sim.nodes import turn as module
from flock_sim.nodes.process import Process, destroy, executing, run_node
from flock_sim.nodes.turn import turn
from terminal import own_domain, segments
from visitor import tell_fast_dds


def somebody_has_a_turn() -> bool:
    with socket.socket(socket.AF_UNIX) as claim:
        return not claimed(claim, "participant")


def test_one_at_a_time_has_a_turn() -> None:
    there, most = 0, 0

    def work() -> None:
        nonlocal there, most
        for _ in range(20):
            with turn():
                there += 1
                most = max(most, there)
                time.sleep(0.001)
                there -= 1

    threads = [threading.Thread(target=work) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert most == 1


def test_who_never_gets_a_turn_goes_on_without(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "PATIENCE", 0.05)
    been = []
    with turn(), turn():
        been.append(1)
    assert been


def test_a_participant_is_ended_in_a_turn(context: Context) -> None:
    seen: list[bool] = []

    class Watched(Node):
        def destroy_node(self) -> None:
            seen.append(somebody_has_a_turn())
            super().destroy_node()

    with executing("events", context) as executor:
        for name in ("one", "two"):
            executor.add_node(Watched(name, context=context))
    destroy(Watched("three", context=context))
    assert seen == [True] * 3


def test_a_process_keeps_the_participant_with_which_it_read_its_parameters(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path / "log"))
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    # As they were: the process of the test goes on.
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    shared: list[set[Path]] = []
    names: list[list[str]] = []

    def work(process: Process) -> None:
        shared.append(segments(os.getpid()))
        with executing("single", process.context) as executor:
            node = Node("bird", context=process.context, enable_rosout=False)
            executor.add_node(node)
            process.settle()
            names.append(node.get_node_names())
            shared.append(segments(os.getpid()))

    try:
        with own_domain() as domain:
            monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
            tell_fast_dds(monkeypatch)
            status = run_node("bird", "A bird.", "", work)(["--ros-args", "-p", "birds:=3"])
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    assert status == 0
    at_first, in_the_end = shared
    assert at_first
    assert at_first <= in_the_end
    assert names == [["bird"]]
