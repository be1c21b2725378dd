# SPDX-License-Identifier: Apache-2.0
"""The recorder as a ROS 2 node: it writes every recorded state to disk, and reports its progress.

The node has the endpoints and the time; what it does with a message is in `recorder_protocol.py`.
"""

from __future__ import annotations

import time

from rclpy.context import Context
from rclpy.executors import Executor
from rclpy.publisher import Publisher

from flock_interfaces.msg import Checkpoint, Grant, Perturbation, Progress
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.console.signals import Stop
from flock_sim.messages import topics
from flock_sim.messages import types as messages
from flock_sim.messages.epochs import NEVER
from flock_sim.nodes.own_birds import announced
from flock_sim.nodes.recorder_protocol import Message, RecorderProtocol
from flock_sim.nodes.row_topics import RowTopics
from flock_sim.recording.flight_writer import Recording
from flock_sim.recording.own_parts import add_parts
from flock_sim.recording.row_assembler import Row
from flock_sim.ros.diagnostics import Diagnostics, Status, ignored
from flock_sim.ros.endpoints import DrainedNode, latched
from flock_sim.ros.process import new_incarnation
from flock_sim.ros.rejection_warnings import RejectionWarnings
from flock_sim.ros.watchdog import Watchdog

WAIT = 0.004
"""Wait of the recorder when no message has come, in s: batches of messages are cheaper."""

LONGEST_WAIT = 0.02
"""The same, in s, if listeners fetch the states in batches some time after publication."""

CHECK_EVERY = 1.0
"""Time between checks that the file still exists and has the recorded content, in s."""

REPORT_EVERY = 1.0
"""Time between two reports of a waiting recorder, in s."""

GOODBYE = 10.0
"""Longest time that a complete recorder stays for the clock to learn of it, in s."""

LINGER = 0.5
"""Longest time before a complete row goes on disk when no others follow, in s."""


class RecorderNode(DrainedNode):
    """The recorder: moves messages from the topics through the protocol into the bag."""

    def __init__(
        self,
        configuration: FlockConfiguration,
        run: Recording,
        run_id: int,
        record_stages: bool,
        *,
        factor: float = 0.0,
        context: Context | None = None,
    ) -> None:
        """Subscribe to a flock of `configuration`; `run_id` 0: the run of the first grant.

        `factor` is the real-time factor of a free flight.
        """
        super().__init__(
            topics.RECORDER,
            namespace=topics.NAMESPACE,
            context=context,
        )
        self.protocol = RecorderProtocol(
            configuration, run, run_id, new_incarnation(), record_stages, factor
        )
        self.assembler = self.protocol.assembler
        self._configuration = configuration
        self._run = run
        self.rest = min(LONGEST_WAIT, topics.fetch_period(configuration) or WAIT)
        """Wait when no message has come, in s."""
        if record_stages:  # the flock is never far ahead of the disk
            self.rest = WAIT
        self._unsaved_since = 0.0  # monotonic time, in s
        self._check_at = 0.0  # monotonic time of the next check of the file, in s
        self._rows_at_once = max(
            1, topics.steps_ahead(configuration, record_stages) // configuration.record_every // 4
        )
        self._outlets: dict[type[Message], Publisher] = {
            messages.Progress: self.create_publisher(Progress, topics.PROGRESS_TOPIC, latched(1)),
            messages.Checkpoint: self.create_publisher(
                Checkpoint, topics.CHECKPOINT_TOPIC, latched(1)
            ),
        }
        self._grants = self.subscribe_drained(Grant, topics.GRANT_TOPIC)
        self._perturbations = self.subscribe_drained(Perturbation, topics.PERTURBATION_TOPIC)
        self._rejection_warnings = RejectionWarnings(self, self.protocol.ignored_for)
        self._diagnostics = Diagnostics(self)
        self._row_topics = RowTopics(
            self,
            configuration,
            self.assembler,
            self.protocol.receive_wing,
            self._write,
            stages=record_stages,
            free=factor > 0.0,
        )

    def drain(self) -> bool:
        """Take all messages; return whether any was accepted."""
        protocol = self.protocol
        ignored, taken = self.assembler.ignored, 0
        while (data := self._grants.take()) is not None:
            taken += 1
            epoch = protocol.epoch
            self._send(protocol.receive_grant(data))
            if protocol.epoch != epoch:
                self._row_topics.expect_all()
        while (data := self._perturbations.take()) is not None:
            taken += 1
            protocol.receive_push(data)
        if protocol.joined:
            taken += self._row_topics.take()
        else:
            self._row_topics.make_room(protocol.epoch != NEVER)
            self._join()
        return taken > self.assembler.ignored - ignored

    @property
    def finished(self) -> bool:
        """Whether all rows are on disk, and the clock has ended the run."""
        return self.protocol.finished

    def look_around(self) -> None:
        """Publish rejection warnings and diagnostics, and check the file.

        Raises RunFailed if the file does not have the recorded content.
        """
        if time.monotonic() >= self._check_at:
            self._check_at = time.monotonic() + CHECK_EVERY
            self._run.bag.check()
        self._rejection_warnings.tell()
        self._diagnostics.tell(self._status)

    def report(self) -> None:
        """Repeat the progress report, for a clock that was restarted."""
        self._send(self.protocol.report())

    def keep_safe(self) -> None:
        """Write rows to disk if they are many or have waited for LINGER, and report it."""
        rows = self.protocol.unsaved
        if rows:
            waited = time.monotonic() - self._unsaved_since
            if self.assembler.complete or rows >= self._rows_at_once or waited > LINGER:
                self._send(self.protocol.save())
        if self.assembler.complete_to(self._configuration.steps):
            if not self._run.closed:
                self.get_logger().info(f"the flight is on disk up to step {self._run.saved}")
            self._run.close()

    @property
    def waiting_for(self) -> str:
        """What the recorder needs to continue, as text."""
        unfound = self._row_topics.unfound() if self.protocol.may_join else []
        return ", ".join(unfound) or self.protocol.waiting_for

    def _join(self) -> None:
        """Take the rows of an epoch once the topics of all birds have been discovered."""
        protocol = self.protocol
        if protocol.may_join and (self.assembler.complete or self._row_topics.found_all()):
            self._row_topics.look_at_all()
            self._name_own_birds()
            self._send(protocol.join())
            self.get_logger().info(
                f"epoch {protocol.epoch} is recorded after step {self._run.saved}"
            )

    def _name_own_birds(self) -> None:
        """Write the names of the birds that are not Flock's into the bag."""
        if not self._run.closed:
            add_parts(self._run.bag, announced(self))

    def _write(self, rows: list[Row]) -> None:
        if not self.protocol.unsaved:
            self._unsaved_since = time.monotonic()
        self.protocol.write(rows)

    def _send(self, out: list[Message]) -> None:
        for message in out:
            self._outlets[type(message)].publish(message.encode())

    def _status(self) -> Status:
        joined, saved = self.protocol.joined, self._run.saved
        words = f"step {saved} of {self._configuration.steps} is on disk"
        return (
            joined,
            words if joined else f"waiting for {self.waiting_for}",
            {"saved": saved, "epoch": self.protocol.epoch, **ignored(self.protocol.ignored_for)},
        )


def record(node: RecorderNode, executor: Executor, stop: Stop, watchdog: Watchdog) -> None:
    """Record until every row is on disk and the clock has ended the run or is gone.

    Returns early on `stop`. Raises RunFailed if `watchdog` runs out or the bag can't be written.
    """
    reports = 0
    while not stop and not node.finished:
        if node.drain():
            watchdog.reset()
            reports = 0
        else:
            executor.spin_once(timeout_sec=node.rest)
            if node.assembler.complete:
                if watchdog.silence > GOODBYE:
                    return
            else:
                watchdog.wait(lambda: f"the recorder waits for {node.waiting_for}")
        node.keep_safe()
        node.look_around()
        if watchdog.silence > REPORT_EVERY * (reports + 1):
            reports += 1
            node.report()
