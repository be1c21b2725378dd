# SPDX-License-Identifier: Apache-2.0
"""The recorder as a ROS 2 node: it writes every recorded state to disk, and reports its progress.

The last step on disk is the checkpoint. The recorder publishes it at the beginning of an epoch.
"""

from __future__ import annotations

import time

import numpy as np
from rclpy.context import Context
from rclpy.executors import Executor

from flock_interfaces.msg import Checkpoint, Grant, Perturbation, Progress
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.console.signals import Stop
from flock_sim.messages import topics
from flock_sim.messages import types as messages
from flock_sim.messages.epochs import NEVER, in_order, out_of_date
from flock_sim.messages.rejection import FOREIGN, IMPOSSIBLE, MALFORMED, STALE
from flock_sim.nodes.own_birds import announced
from flock_sim.nodes.requested_pushes import RequestedPushes
from flock_sim.nodes.row_topics import RowTopics
from flock_sim.protocol.attendance import ABSENT
from flock_sim.protocol.session import Session
from flock_sim.recording.flight_writer import Recording
from flock_sim.recording.own_parts import add_parts
from flock_sim.recording.row_assembler import Row, RowAssembler
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
    """The recorder: moves messages from the topics through a row assembler into the bag."""

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
        self.assembler = RowAssembler(configuration, record_stages, run.saved, factor > 0.0)
        self.released = False
        """Whether the clock has ended the run."""
        self._configuration = configuration
        self._run = run
        self._session = Session("the recorder", configuration, run_id, new_incarnation(), factor)
        self._granted = -1  # the furthest granted step of this epoch
        self._joined = False  # has published where the epoch begins
        self.rest = min(LONGEST_WAIT, topics.fetch_period(configuration) or WAIT)
        """Wait when no message has come, in s."""
        if record_stages:  # the flock is never far ahead of the disk
            self.rest = WAIT
        self._unsafe_since: float | None = None
        self._check_at = 0.0  # monotonic time of the next check of the file, in s
        self._rows = 0
        self._rows_at_once = max(
            1, topics.steps_ahead(configuration, record_stages) // configuration.record_every // 4
        )
        self._progress = self.create_publisher(Progress, topics.PROGRESS_TOPIC, latched(1))
        self._checkpoint = self.create_publisher(Checkpoint, topics.CHECKPOINT_TOPIC, latched(1))
        self._grants = self.subscribe_drained(Grant, topics.GRANT_TOPIC)
        self._perturbations = self.subscribe_drained(Perturbation, topics.PERTURBATION_TOPIC)
        self._wanted = 0  # number of the last perturbation of this epoch
        self._pushes = RequestedPushes(configuration, run, self._session)
        self._rejection_warnings = RejectionWarnings(self, self.assembler.ignored_for)
        self._diagnostics = Diagnostics(self)
        self._row_topics = RowTopics(
            self,
            configuration,
            self.assembler,
            self._hear_wing,
            self._write,
            stages=record_stages,
            free=factor > 0.0,
        )

    def drain(self) -> bool:
        """Take all messages; return whether any was accepted."""
        ignored, taken = self.assembler.ignored, 0
        while (data := self._grants.take()) is not None:
            taken += 1
            self._hear_grant(data)
        while (data := self._perturbations.take()) is not None:
            taken += 1
            if reason := self._pushes.hear(data):
                self.assembler.ignored_for[reason] += 1
        if self._joined:
            taken += self._row_topics.take()
        else:
            self._row_topics.make_room(self._session.epoch != NEVER)
            self._join()
        return taken > self.assembler.ignored - ignored

    @property
    def finished(self) -> bool:
        """Whether all rows are on disk, and the clock has ended the run."""
        return self.assembler.complete and self.released

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
        """Repeat the progress report, for a clock that was restarted.

        Before the epoch begins here, the report only says which epoch it is: a clock of an earlier
        one could otherwise not know of it.
        """
        if self._session.epoch != NEVER:
            self._tell(self._run.saved if self._joined else ABSENT)

    def keep_safe(self) -> None:
        """Write rows to disk if they are many or have waited for LINGER, and report it."""
        if self._unsafe_since is not None:
            waited = time.monotonic() - self._unsafe_since
            if self.assembler.complete or self._rows >= self._rows_at_once or waited > LINGER:
                self._save()
                self._tell(self._run.saved)
        if self.assembler.complete_to(self._configuration.steps):
            if not self._run.closed:
                self.get_logger().info(f"the flight is on disk up to step {self._run.saved}")
            self._run.close()

    @property
    def waiting_for(self) -> str:
        """What the recorder needs to continue, as text."""
        if self._session.epoch == NEVER:
            return "the clock's first grant"
        if not self._joined:
            return ", ".join(self._row_topics.unfound()) or "the clock's perturbation"
        if self.assembler.complete:
            return "the clock's message that the run is over"
        names = [topics.bird_name(bird) for bird in self.assembler.waiting_for]
        return ", ".join(names) or "the clock"

    def _save(self) -> None:
        self._run.flush()
        self._unsafe_since, self._rows = None, 0

    def _hear_grant(self, data: bytes) -> None:
        session = self._session
        try:
            grant = messages.Grant.decode(data)
        except ValueError:
            self.assembler.ignored_for[MALFORMED] += 1
            return
        reason = session.refuses_grant(grant)
        later = self._later_epoch(grant)
        if not reason and session.epoch == NEVER and later != NEVER:
            # The clock is a new one, and must begin an epoch later than those in the bag.
            self._tell(self._run.saved, grant.run_id, later)
            reason = STALE
        if reason:
            self.assembler.ignored_for[reason] += 1
            return
        new = session.take_grant(grant)
        if new:
            self.released = False
            self._begin(grant)
        self.released |= grant.step > grant.end
        self.assembler.end_at(grant.end)
        if grant.step > self._granted and not self.assembler.complete:
            self._granted = grant.step
            self._run.write_grant(grant.encode())
            if new:
                self._save()  # a later recorder must know the epoch

    def _later_epoch(self, grant: messages.Grant) -> int:
        """Return the last epoch in the bag that is later than a grant's; NEVER without one.

        Epochs of this run and of pushes count. One out of reach was forged.
        """
        last = self._run.last_grant
        known = [*self._run.live, *([last.epoch] if last and last.run_id == grant.run_id else [])]
        later = [epoch for epoch in known if out_of_date(grant.epoch, epoch)]
        return in_order(later)[-1] if later else NEVER

    def _begin(self, grant: messages.Grant) -> None:
        """Begin an epoch: complete rows go on disk, the birds send the others again."""
        self._granted = -1
        self._wanted = grant.perturbation
        if not self._run.closed:
            self._save()
        self.assembler.begin(grant.run_id, grant.epoch)
        self._joined = False
        self._row_topics.expect_all()
        self._join()

    def _join(self) -> None:
        """Publish where the epoch begins, once every bird's topics have been discovered.

        Otherwise messages latched by a bird would be lost to us when it ends.
        """
        told = self._wanted == 0 or self._wanted in self._pushes
        if self._session.epoch == NEVER or not told:
            return
        if self.assembler.complete or self._row_topics.found_all():
            self._joined = self._session.flying = True
            self._row_topics.look_at_all()
            self._name_own_birds()
            if self._pushes.write(self._wanted):
                self._save()
            self._checkpoint.publish(self._where().encode())
            self._tell(self._run.saved)
            self.get_logger().info(
                f"epoch {self._session.epoch} is recorded after step {self._run.saved}"
            )

    def _name_own_birds(self) -> None:
        """Write the names of the birds that are not Flock's into the bag."""
        if not self._run.closed:
            add_parts(self._run.bag, announced(self))

    def _where(self) -> messages.Checkpoint:
        """Return the checkpoint of this epoch: the last row on disk."""
        states = [messages.State.decode(data) for data in self._run.checkpoint]
        memories = [messages.Memory.decode(data) for data in self._run.memories]
        pushes = " ".join(map(str, self._run.live.values()))
        run_id, epoch = self._session.run_id, self._session.epoch
        if not states:
            return messages.Checkpoint.of_start(run_id, epoch, pushes)
        return messages.Checkpoint(
            run_id,
            self._run.saved,
            epoch,
            np.concatenate([state.position for state in states]),
            np.concatenate([state.speed for state in states]),
            pushes,
            np.concatenate([np.empty(0), *(memory.data for memory in memories)]),
            np.concatenate([state.forcing_state for state in states]),
        )

    def _hear_wing(self, bird: int, data: bytes) -> list[Row]:
        wing = messages.Wing.decode(data)
        if wing.run_id != self._session.run_id:
            self.assembler.ignored_for[FOREIGN] += 1
            return []
        if not np.array_equal(wing.span_ratio, self._configuration.span_ratio[bird - 1]):
            self.assembler.ignored_for[IMPOSSIBLE] += 1  # birds of this run agree with the clock
            return []
        return self.assembler.add_wing(bird, data)

    def _write(self, rows: list[Row]) -> None:
        for row in rows:
            self._run.write_row(row)
            self._rows += 1
            if self._unsafe_since is None:
                self._unsafe_since = time.monotonic()

    def _tell(self, step: int, run_id: int = 0, epoch: int = 0) -> None:
        """Report the last step on disk, by default in the current run and epoch."""
        session = self._session
        run_id, epoch = run_id or session.run_id, epoch or session.epoch
        progress = messages.Progress(run_id, step, epoch, topics.RECORDER, session.incarnation)
        self._progress.publish(progress.encode())

    def _status(self) -> Status:
        saved = self._run.saved
        words = f"step {saved} of {self._configuration.steps} is on disk"
        return (
            self._joined,
            words if self._joined else f"waiting for {self.waiting_for}",
            {"saved": saved, "epoch": self._session.epoch, **ignored(self.assembler.ignored_for)},
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
