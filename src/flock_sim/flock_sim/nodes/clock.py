# SPDX-License-Identifier: Apache-2.0
"""The clock as a ROS 2 node: it keeps the flock together and publishes the simulated time."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable

from rclpy.context import Context
from rclpy.executors import Executor
from rosgraph_msgs.msg import Clock

from flock_interfaces.msg import Checkpoint, Grant, Perturbation, Progress
from flock_sim.console.signals import Stop
from flock_sim.errors import FlockError, RunFailed
from flock_sim.messages import topics
from flock_sim.messages import types as messages
from flock_sim.messages.epochs import ahead, out_of_reach
from flock_sim.messages.rejection import MALFORMED
from flock_sim.nodes.clock_services import Control
from flock_sim.protocol.clock import Message, Timekeeper
from flock_sim.protocol.free_flight import NO_WAY_BACK
from flock_sim.ros.diagnostics import Diagnostics, Status, ignored
from flock_sim.ros.endpoints import ALL, FlockNode, latched, wait_until_heard
from flock_sim.ros.rejection_warnings import RejectionWarnings
from flock_sim.ros.watchdog import Watchdog

WAIT = 0.05
"""Longest single wait for messages, in s."""

REPEAT_EVERY = 1.0
"""Time between repeats of the last grant, in s. They show that the clock is alive."""


FAREWELL = 10.0
"""Longest wait for listeners to receive the end of the run, in s."""


RIVAL_SILENCE = 3 * REPEAT_EVERY
"""Time without a grant of another clock after which there is none, in s."""


class Rival:
    """Whether another clock leads the run. One grant of it is not enough: it repeats them."""

    def __init__(self) -> None:
        self.leads = False
        self._heard_at = -math.inf
        self._expected_from = math.inf

    @property
    def heard(self) -> bool:
        """Whether another clock's grant arrived recently."""
        return time.monotonic() - self._heard_at < RIVAL_SILENCE

    def missed(self) -> bool:
        """Whether no grant of another clock has arrived since a first call long enough ago."""
        self._expected_from = min(self._expected_from, time.monotonic())
        return time.monotonic() - max(self._expected_from, self._heard_at) >= RIVAL_SILENCE

    def hear(self) -> None:
        """Note a grant of another clock that is ahead of this one's."""
        self.leads |= self.heard
        self._heard_at = time.monotonic()


class ClockNode(FlockNode):
    """The clock: moves messages between a Timekeeper and the topics."""

    def __init__(self, keeper: Timekeeper, depth: int, *, context: Context | None = None) -> None:
        """Begin the run of `keeper`; `depth` is the queue depth of /clock."""
        super().__init__("clock", namespace=topics.NAMESPACE, context=context)
        self.keeper = keeper
        self.rate = 0.0
        """Recent steps per second."""
        self._rated = (time.monotonic(), 0)
        self._in_flight = False
        self._rewinds = 0
        self._led = False
        self._rival = Rival()
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
        self._rejection_warnings = RejectionWarnings(self, keeper.ignored_for)
        self._diagnostics = Diagnostics(self)
        self.get_logger().info(f"waiting for {listing(keeper.waiting_for)}")
        self._send(keeper.first_messages)

    def repeat(self) -> None:
        """Repeat the last grant, and a push that is not on disk yet."""
        self._send(self.keeper.repeated)

    def rewind(self) -> None:
        """Rewind the flock to the last step on disk."""
        self._send(self.keeper.rewind())

    def look_around(self) -> None:
        """Publish the state of the flight: log messages, rejection warnings and diagnostics.

        Raises FlockError if another clock leads the run, and RunFailed if a free flight would need
        a rewind. It raises here since rclpy would report an exception of a callback itself.
        """
        if self.keeper.lost:
            raise RunFailed(NO_WAY_BACK)
        if self._rival.leads:
            raise FlockError(
                f"another clock controls run {self.keeper.run_id}: end it first, or give this one "
                "another run_id"
            )
        self._led |= self.keeper.begun and self._leads()
        self._log()
        self._rejection_warnings.tell()
        self._diagnostics.tell(self._status)

    def release(self, stop: Stop | bool = False) -> None:
        """Release the other nodes if the run is finished.

        A stopped run takes two messages. Between them the clock waits, for REPEAT_EVERY at most or
        until `stop`, since a node that still lacks the first one gets the second one only.
        """
        self._log()
        if self.keeper.finished:
            self.get_logger().info(f"the flight is over {self.keeper.where}")
            self._send([self.keeper.release])
            if self.keeper.stopped:
                wait_until_heard([self._outlets[messages.Grant]], stop, REPEAT_EVERY)
                self._send([self.keeper.release])

    def farewell(self, stop: Stop) -> None:
        """Wait until all listeners have received everything, or until `stop`."""
        wait_until_heard(self._outlets.values(), stop, FAREWELL)

    def _log(self) -> None:
        """Log the beginning of the flight, and rewinds."""
        keeper = self.keeper
        if keeper.rewinds.count > self._rewinds:
            self._rewinds, self._in_flight = keeper.rewinds.count, False
            self.get_logger().warning(f"the flock is rewound: epoch {keeper.epoch} begins")
        if keeper.begun and not self._in_flight:
            self._in_flight = True
            self.get_logger().info(f"all nodes are present; the flock flies, {keeper.where}")

    def _hear(self, data: bytes) -> None:
        try:
            progress = messages.Progress.decode(data)
        except ValueError:
            self.keeper.ignored_for[MALFORMED] += 1
        else:
            self._send(self.keeper.receive(progress))

    def _hear_another(self, data: bytes) -> None:
        """Note another clock that already leads the run: a flock needs only one."""
        try:
            grant = messages.Grant.decode(data)
        except ValueError:
            return
        ours = self.keeper.grant
        if self._led or (grant.run_id, grant.terms) != (ours.run_id, ours.terms):
            return
        if out_of_reach(grant.epoch, ours.epoch):
            return
        later = ahead(grant.epoch, ours.epoch)
        if later > 0 or (later == 0 and grant.step > ours.step):
            self._rival.hear()

    def _leads(self) -> bool:
        """Whether this clock leads the flock that flies by its grants.

        A flock that has flown before had another clock. If that one still runs, its grants may
        arrive after the reports of the flock, by which this clock has begun.
        """
        began = self.keeper.began
        begun_here = began is not None and began <= 0 and not self.keeper.rewinds.count
        return not self._rival.heard if begun_here else self._rival.missed()

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
                "recorder lag": max(0, keeper.step - max(keeper.saved, 0)),
                **ignored(keeper.ignored_for),
            },
        )


def keep_time(
    clock: ClockNode, executor: Executor, watchdog: Watchdog, watch: Callable[[], object]
) -> tuple[float, float]:
    """Serve `clock` until its run is finished or `watch`, called every WAIT or so, is true.

    Returns the monotonic times, in s, at which all nodes were present and the run was over. A
    flock that stands still is rewound to the last step on disk once. Raises RunFailed if `watchdog`
    still runs out.
    """
    keeper = clock.keeper
    moves = -1
    stuck = -1  # the step at which the flock stood still before the last rewind
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
            watchdog.reset()
        elif keeper.begun and not keeper.free and keeper.step > stuck and watchdog.half_elapsed:
            stuck = keeper.step
            clock.rewind()
        else:
            watchdog.wait(lambda: f"waiting for {listing(keeper.waiting_for)} ({keeper.where})")
        if now - repeated >= REPEAT_EVERY:
            repeated = now
            clock.repeat()
    ended = time.monotonic()
    return ended if begun is None else begun, ended


def listing(names: list[str], most: int = 8) -> str:
    """Return the first `most` names as text, with the number of the others."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more
