# SPDX-License-Identifier: Apache-2.0
"""How long a flock stands still when a bird is killed: from the kill to the first new step.

Flies a flock in several processes over ROS 2, kills the process of a bird again and again, and
listens to the birds' reports: the flock flies again when a bird reports a step of a new epoch
beyond the one that epoch began with.
"""

from __future__ import annotations

import argparse
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median

import psutil
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from flock_interfaces.msg import Progress
from flock_sim.messages import topics
from flock_sim.messages import types as messages
from flock_sim.ros.discovery import own_domain, prepare_discovery
from flock_sim.ros.endpoints import latched

BIRD = "flock_sim.nodes.bird_process"
LIMIT = 60.0
"""Longest wait, in s, for a flock to fly."""


class Listener(Node):
    """Follows the reports of the birds."""

    def __init__(self) -> None:
        super().__init__("recovery_benchmark", start_parameter_services=False)
        self.epoch = -1
        self.first = self.last = 0  # steps of this epoch
        self.create_subscription(
            Progress, topics.PROGRESS_TOPIC, self._hear, latched(100), raw=True
        )

    def _hear(self, data: bytes) -> None:
        told = messages.Progress.decode(data)
        if not told.who.startswith("bird") or told.step < 0:
            return
        if told.epoch > self.epoch:
            self.epoch, self.first = told.epoch, told.step
        if told.epoch == self.epoch:
            self.last = told.step

    @property
    def flying(self) -> bool:
        """Whether a step of this epoch has been flown."""
        return self.last > self.first


def until(condition: Callable[[], bool], executor: SingleThreadedExecutor) -> None:
    """Serve the listener until `condition` is true."""
    deadline = time.monotonic() + LIMIT
    while not condition():
        executor.spin_once(timeout_sec=0.01)
        if time.monotonic() > deadline:
            raise SystemExit(f"the flock does not fly within {LIMIT:g} s")


def bird(parent: int) -> psutil.Process:
    """Return a process of birds of a flight."""
    found = psutil.Process(parent).children(recursive=True)
    return next(process for process in found if BIRD in " ".join(process.cmdline()))


def time_of_recovery(flight: int, listener: Listener, executor: SingleThreadedExecutor) -> float:
    """Kill a process of birds; return the time, in s, until the flock flies again."""
    until(lambda: listener.flying, executor)
    settled = time.monotonic() + 1.0  # so that there is something new on disk
    until(lambda: time.monotonic() > settled, executor)
    epoch, killed = listener.epoch, time.monotonic()
    bird(flight).kill()
    until(lambda: listener.epoch > epoch and listener.flying, executor)
    return time.monotonic() - killed


def main() -> None:
    """Kill birds and print the times."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--birds", type=int, default=13)
    parser.add_argument("--processes", type=int, default=3)
    options = parser.parse_args()
    prepare_discovery()
    with own_domain(), tempfile.TemporaryDirectory() as directory:
        command = [
            sys.executable,
            "-P",
            "-m",
            "flock_sim.commands.fly",
            "--birds",
            str(options.birds),
        ]
        command += ["--processes", str(options.processes), "--t-max", "1e8"]
        command += ["--output", str(Path(directory) / "bag")]
        flight = subprocess.Popen(command, stderr=subprocess.DEVNULL)
        rclpy.init()
        listener, took = Listener(), []
        executor = SingleThreadedExecutor()
        executor.add_node(listener)
        try:
            for _ in range(options.kills):
                took.append(time_of_recovery(flight.pid, listener, executor))
                print(f"{took[-1]:.2f} s", flush=True)
        finally:
            flight.send_signal(signal.SIGINT)
            flight.wait()
            rclpy.shutdown()
    print(f"median {median(took):.2f} s, from {min(took):.2f} to {max(took):.2f} s")


if __name__ == "__main__":
    main()
