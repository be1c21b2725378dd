# SPDX-License-Identifier: Apache-2.0
"""The clock as a ROS 2 node: it keeps the flock together and tells the simulated time."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable

from rclpy.context import Context
from rclpy.executors import Executor
from rclpy.node import Node
from rosgraph_msgs.msg import Clock

from flock_interfaces.msg import Grant, Progress
from flock_sim.core import messages, topics
from flock_sim.core.timekeeper import Timekeeper, new_run_id
from flock_sim.nodes.endpoints import latched, wait_until_heard
from flock_sim.nodes.parameters import OF_ALL, declare
from flock_sim.nodes.patience import Patience
from flock_sim.nodes.process import Process, executing, run_node
from flock_sim.stop import Stop

WAIT = 0.05
"""How long the clock waits for news at a time, in s."""


class ClockNode(Node):
    """The clock: moves messages between a Timekeeper and the topics."""

    def __init__(self, keeper: Timekeeper, depth: int, *, context: Context | None = None) -> None:
        """Begin the run of `keeper`; `depth` is that of the queue of /clock."""
        super().__init__("clock", namespace=topics.NAMESPACE, context=context)
        self.keeper = keeper
        self._outlets = {
            messages.Grant: self.create_publisher(
                Grant, topics.GRANT_TOPIC, latched(topics.GRANT_DEPTH)
            ),
            messages.Time: self.create_publisher(Clock, topics.CLOCK_TOPIC, latched(depth)),
        }
        self.create_subscription(
            Progress, topics.PROGRESS_TOPIC, self._hear, latched(1000), raw=True
        )
        self._send(keeper.first_grant)

    def farewell(self, stop: Stop | bool) -> None:
        """Let everybody go, and wait until all who listen have heard it, or `stop`."""
        if self.keeper.finished:
            self._send(self.keeper.release)
        for outlet in self._outlets.values():
            wait_until_heard(outlet, stop)

    def _hear(self, data: bytes) -> None:
        for message in self.keeper.receive(messages.Progress.decode(data)):
            self._send(message)

    def _send(self, message: messages.Grant | messages.Time) -> None:
        self._outlets[type(message)].publish(message.encode())


def keep_time(
    clock: ClockNode, executor: Executor, patience: Patience, watch: Callable[[], object]
) -> float:
    """Serve `clock` until its run is finished or `watch`, called every WAIT or so, is true.

    Returns how long, in s, the run took since all were there. Raises RunFailed when `patience` runs
    out in a flock that stands still.
    """
    keeper = clock.keeper
    moves = -1
    begun = watched = time.monotonic()
    while not keeper.finished:
        if time.monotonic() - watched >= WAIT:
            watched = time.monotonic()
            if watch():
                break
        if not keeper.begun:
            begun = time.monotonic()
        executor.spin_once(timeout_sec=WAIT)
        if keeper.moves != moves:
            moves = keeper.moves
            patience.renew()
        else:
            patience.wait(lambda: f"waiting for {listing(keeper.waiting_for)} ({keeper.where})")
    return time.monotonic() - begun


def listing(names: list[str], most: int = 8) -> str:
    """Return names for a sentence, the first `most` of them."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more


def work(process: Process) -> None:
    """Be the clock of one run."""
    operation = process.operation
    keeper = Timekeeper(
        process.configuration,
        operation["run_id"] or new_run_id(),
        operation["window"],
        operation["record"],
        operation["record_stages"],
    )
    with executing(operation["executor"], process.context) as executor:
        depth = topics.depth(topics.CLOCK_TOPIC, process.configuration)
        clock = ClockNode(keeper, depth, context=process.context)
        own = ("window", "record", "record_stages", *OF_ALL)
        declare(clock, process.configuration, operation, own)
        executor.add_node(clock)
        keep_time(clock, executor, process.patience(), lambda: process.stop)
        clock.farewell(process.stop)


_main = run_node(
    "clock",
    "The clock of a flock as a ROS 2 node: waits until all birds (and the recorder) are there,\n"
    "grants steps, tells the simulated time, and ends with the flight.\n\n"
    "parameters: window (64; 1 is lockstep), record (true: wait for a recorder), record_stages,\n"
    "run_id, timeout (s without progress), executor (events|single), and all keys of the\n"
    "configuration file.",
    "  ./flock clock --ros-args --params-file flock.yaml\n"
    "  ./flock clock --timeout 20 --ros-args -p birds:=3 -p record:=false",
    work,
)


def main() -> int:
    """Run the `clock` executable."""
    return _main(None)


if __name__ == "__main__":
    sys.exit(main())
