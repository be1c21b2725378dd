# SPDX-License-Identifier: Apache-2.0
"""The clock as a ROS 2 node: it keeps the flock together and tells the simulated time."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterable

from rclpy.context import Context
from rclpy.executors import Executor
from rclpy.node import Node
from rosgraph_msgs.msg import Clock

from flock_interfaces.msg import Checkpoint, Grant, Perturbation, Progress
from flock_sim.core import messages, topics
from flock_sim.core.free_flight import NO_WAY_BACK
from flock_sim.core.stage_inbox import MALFORMED
from flock_sim.core.terms import run_id_of
from flock_sim.core.timekeeper import Message, Timekeeper
from flock_sim.errors import FlockError, RunFailed
from flock_sim.nodes.complaints import Complaints
from flock_sim.nodes.control import Control
from flock_sim.nodes.diagnostics import Diagnostics, Status, ignored
from flock_sim.nodes.endpoints import ALL, latched, wait_until_heard
from flock_sim.nodes.parameters import OF_ALL, declare
from flock_sim.nodes.patience import Patience
from flock_sim.nodes.process import Process, executing, run_node
from flock_sim.stop import Stop

OWN = ("window", "record", "record_stages", *OF_ALL)
"""What a clock is told of how it operates."""

WAIT = 0.05
"""How long the clock waits for news at a time, in s."""

REPEAT_EVERY = 1.0
"""How often, in s, the last leave is said again: who hears it knows that the clock is there."""


FAREWELL = 10.0
"""Longest wait, in s, for listeners to hear that the run is over."""


class ClockNode(Node):
    """The clock: moves messages between a Timekeeper and the topics."""

    def __init__(self, keeper: Timekeeper, depth: int, *, context: Context | None = None) -> None:
        """Begin the run of `keeper`; `depth` is that of the queue of /clock."""
        super().__init__("clock", namespace=topics.NAMESPACE, context=context)
        self.keeper = keeper
        self.rate = 0.0
        """Steps a second, lately."""
        self._rated = (time.monotonic(), 0)
        self._led = False
        self._outdone = False  # by another clock, which leads this run
        self._outlets = {
            messages.Grant: self.create_publisher(Grant, topics.GRANT_TOPIC, latched(1)),
            messages.Time: self.create_publisher(Clock, topics.CLOCK_TOPIC, latched(depth)),
            messages.Checkpoint: self.create_publisher(
                Checkpoint, topics.CHECKPOINT_TOPIC, latched(1)
            ),
            messages.Push: self.create_publisher(
                Perturbation, topics.PERTURBATION_TOPIC, latched(topics.PERTURBATION_DEPTH)
            ),
        }
        self.create_subscription(Progress, topics.PROGRESS_TOPIC, self._hear, ALL, raw=True)
        self.create_subscription(Grant, topics.GRANT_TOPIC, self._hear_another, ALL, raw=True)
        self._control = Control(self, keeper, self._send)
        self._complaints = Complaints(self.get_name(), keeper.ignored_for)
        self._diagnostics = Diagnostics(self)
        self._send(keeper.first_messages)

    def repeat(self) -> None:
        """Say again what leave there is."""
        self._send([self.keeper.grant])

    def look_around(self) -> None:
        """Tell of what is amiss, and how the flight goes.

        Raises FlockError where another clock leads the run, RunFailed where a free flight is lost:
        in a callback, rclpy would tell of it.
        """
        if self.keeper.lost:
            raise RunFailed(NO_WAY_BACK)
        if self._outdone:
            raise FlockError(
                f"another clock leads run {self.keeper.run_id}: end it first, or give this one "
                "another run_id"
            )
        self._led |= self.keeper.begun
        self._complaints.tell()
        self._diagnostics.tell(self._status)

    def release(self) -> None:
        """Let everybody go."""
        if self.keeper.finished:
            self._send([self.keeper.release])

    def farewell(self, stop: Stop) -> None:
        """Wait until all who listen have heard everything, or `stop`."""
        wait_until_heard(self._outlets.values(), stop, FAREWELL)

    def _hear(self, data: bytes) -> None:
        try:
            progress = messages.Progress.decode(data)
        except ValueError:
            self.keeper.ignored_for[MALFORMED] += 1
        else:
            self._send(self.keeper.receive(progress))

    def _hear_another(self, data: bytes) -> None:
        """Leave the run to another clock that leads it already: a flock needs one."""
        try:
            grant = messages.Grant.decode(data)
        except ValueError:
            return
        ours = self.keeper.grant
        ahead = (grant.epoch, grant.step) > (ours.epoch, ours.step)
        self._outdone |= grant.run_id == ours.run_id and ahead and not self._led

    def _send(self, outgoing: Iterable[Message]) -> None:
        for message in outgoing:
            self._outlets[type(message)].publish(message.encode())

    def _status(self) -> Status:
        keeper = self.keeper
        now, (then, before) = time.monotonic(), self._rated
        if now > then:
            self.rate = max(0.0, (keeper.step - before) / (now - then))
        self._rated = (now, keeper.step)
        waiting = not keeper.begun and not keeper.paused
        words = "paused" if keeper.paused else "waiting" if waiting else "flying"
        return (
            not waiting,
            f"{words}, {keeper.where}",
            {
                "step": keeper.step,
                "end": keeper.end,
                "steps per second": f"{self.rate:.1f}",
                "waiting for": ", ".join(keeper.waiting_for),
                "epoch": keeper.epoch,
                "rewinds": keeper.rewinds.count,
                "steps flown again": keeper.rewinds.steps,
                "recorder lag": keeper.lag,
                **ignored(keeper.ignored_for),
            },
        )


def keep_time(
    clock: ClockNode, executor: Executor, patience: Patience, watch: Callable[[], object]
) -> tuple[float, float]:
    """Serve `clock` until its run is finished or `watch`, called every WAIT or so, is true.

    Returns the monotonic times, in s, at which all were there and at which the run was over. Raises
    RunFailed when `patience` runs out in a flock that stands still.
    """
    keeper = clock.keeper
    moves = -1
    begun: float | None = None
    watched = repeated = time.monotonic()
    while not keeper.finished:
        now = time.monotonic()
        if now - watched >= WAIT:
            watched = now
            clock.look_around()
            if watch():
                break
        if begun is None and keeper.begun:
            begun = now
        executor.spin_once(timeout_sec=WAIT)
        if keeper.moves != moves or keeper.paused:
            moves = keeper.moves
            patience.renew()
        else:
            patience.wait(lambda: f"waiting for {listing(keeper.waiting_for)} ({keeper.where})")
        if now - repeated >= REPEAT_EVERY:
            repeated = now
            clock.repeat()
    ended = time.monotonic()
    return ended if begun is None else begun, ended


def listing(names: list[str], most: int = 8) -> str:
    """Return names for a sentence, the first `most` of them."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more


def first_epoch() -> int:
    """Return an epoch later than those of any clock before this one, from the system's time.

    In 32 bits, sixteenths of seconds last for eight years, and then begin anew.
    """
    return int(16 * time.time()) % 2**32


def work(process: Process) -> None:
    """Be the clock of one run."""
    operation = process.operation
    keeper = Timekeeper(
        process.configuration,
        operation["run_id"] or run_id_of(process.configuration),
        operation["window"],
        operation["record"],
        operation["record_stages"],
        first_epoch(),
        operation["real_time_factor"],
    )
    with executing(operation["executor"], process.context) as executor:
        depth = topics.depth(topics.CLOCK_TOPIC, process.configuration)
        clock = ClockNode(keeper, depth, context=process.context)
        declare(clock, process.configuration, operation, OWN)
        executor.add_node(clock)
        process.settle()
        keep_time(clock, executor, process.patience(), lambda: process.stop)
        clock.release()
        clock.farewell(process.stop)


_main = run_node(
    "clock",
    "The clock of a flock as a ROS 2 node: waits until all birds (and the recorder) are there,\n"
    "grants steps, tells the simulated time, and ends with the flight. If it dies and is started\n"
    "again with the same parameters, the flight goes on.\n\n"
    "parameters: window (64; 1 is lockstep), record (true: wait for a recorder), record_stages,\n"
    "run_id, timeout (s without progress), executor (events|single), and all keys of the\n"
    "configuration file.\n\n"
    "services: ~/pause, ~/resume, ~/stop (std_srvs/Trigger), ~/step and ~/perturb\n"
    "(flock_interfaces/Step and Perturb).",
    "  ./flock clock --ros-args --params-file flock.yaml\n"
    "  ./flock clock --timeout 20 --ros-args -p birds:=3 -p record:=false\n"
    "  ros2 service call /flock/clock/pause std_srvs/srv/Trigger",
    work,
)


def main() -> int:
    """Run the `clock` executable."""
    return _main(None)


if __name__ == "__main__":
    sys.exit(main())
