# SPDX-License-Identifier: Apache-2.0
"""The recorder as a ROS 2 node: it writes every recorded state to disk, and reports its progress.

The last step on disk is the checkpoint. The recorder publishes it at the beginning of an epoch.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterable
from contextlib import ExitStack
from pathlib import Path
from typing import NamedTuple

import numpy as np
from rclpy.context import Context
from rclpy.executors import Executor
from rosgraph_msgs.msg import Clock

from flock_interfaces.msg import (
    BirdAges,
    BirdMemory,
    BirdStage,
    BirdState,
    BirdWing,
    Checkpoint,
    Grant,
    Perturbation,
    Progress,
)
from flock_sim.bag.writing.partial_bag import recorded_in
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.console.arguments import note
from flock_sim.console.signals import Stop
from flock_sim.errors import FlockError, RunFailed
from flock_sim.messages import topics
from flock_sim.messages import types as messages
from flock_sim.messages.epochs import NEVER, in_order, out_of_date
from flock_sim.messages.rejection import FOREIGN, MALFORMED, REPEATED, STALE
from flock_sim.nodes.played_recorder import check_played, record_played
from flock_sim.protocol.free_flight import GONE, check_free
from flock_sim.protocol.requests import refuses_push
from flock_sim.protocol.session import Session
from flock_sim.recording.flight_writer import Recording, recording
from flock_sim.recording.output_directory import own_bag, own_output
from flock_sim.recording.row_assembler import Row, RowAssembler
from flock_sim.ros.diagnostics import Diagnostics, Status, ignored
from flock_sim.ros.endpoints import DrainedNode, Inlet, latched
from flock_sim.ros.parameters import OF_ALL, declare
from flock_sim.ros.process import Process, executing, new_incarnation, run_node
from flock_sim.ros.rejection_warnings import RejectionWarnings
from flock_sim.ros.watchdog import Watchdog

WAIT = 0.004
"""Wait of the recorder when no message has come, in s: batches of messages are cheaper."""

LONGEST_WAIT = 0.02
"""The same, in s, if listeners fetch the states in batches some time after publication."""

LOOK_EVERY = 0.25
"""Time between looks at all topics, in s, also at those on which no message is due. So messages of
other publishers do not fill the queues."""

CHECK_EVERY = 1.0
"""Time between checks that the file still exists and has the recorded content, in s."""

REPORT_EVERY = 1.0
"""Time between two reports of a waiting recorder, in s."""

GOODBYE = 10.0
"""Longest time that a complete recorder stays for the clock to learn of it, in s."""

LINGER = 0.5
"""Longest time before a complete row goes on disk when no others follow, in s."""


MOST_ASKED = 16
"""Most pushes kept before an epoch begins with them."""


class Source(NamedTuple):
    """A topic of one bird, and the function that takes its messages."""

    inlet: Inlet
    add: Callable[[int, bytes], list[Row]]
    bird: int


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
        services: bool = False,
    ) -> None:
        """Subscribe to a flock of `configuration`; `run_id` 0: the run of the first grant.

        `factor` is the real-time factor of a free flight. `services`: with rosout and the parameter
        services.
        """
        super().__init__(
            topics.RECORDER,
            namespace=topics.NAMESPACE,
            context=context,
            start_parameter_services=services,
            enable_rosout=services,
        )
        self.assembler = RowAssembler(configuration, record_stages, run.saved, factor > 0.0)
        self.released = False
        """Whether the clock has ended the run."""
        self._configuration = configuration
        self._run = run
        self._session = Session("the recorder", configuration, run_id, new_incarnation(), factor)
        self._granted = -1  # the furthest granted step of this epoch
        self._joined = False  # has published where the epoch begins
        self._look_at = 0.0  # monotonic time of the next look at all topics, in s
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
        self._times = self.subscribe_drained(Clock, topics.CLOCK_TOPIC)
        self._perturbations = self.subscribe_drained(Perturbation, topics.PERTURBATION_TOPIC)
        self._wanted = 0  # number of the last perturbation of this epoch
        self._asked: dict[int, messages.Push] = {}  # by number: pushes that no epoch has yet
        self._rejection_warnings = RejectionWarnings(self.get_name(), self.assembler.ignored_for)
        self._diagnostics = Diagnostics(self)
        birds = range(1, configuration.birds + 1)
        self._wings = self._listen(BirdWing, topics.wing_topic, self._hear_wing, birds)
        remember = [bird for bird in birds if configuration.link_table.remembers(bird)]
        self._sources = self._listen(BirdState, topics.state_topic, self.assembler.add_state, birds)
        self._states = len(self._sources)
        if factor:
            self._sources += self._listen(
                BirdAges, topics.ages_topic, self.assembler.add_ages, birds
            )
        else:
            self._sources += self._listen(
                BirdMemory, topics.memory_topic, self.assembler.add_memory, remember
            )
        if record_stages:
            self._sources += self._listen(
                BirdStage, topics.stage_topic, self.assembler.add_stage, birds
            )
        self._place = 0  # index of the next source
        self._not_found = [source.inlet for source in (*self._wings, *self._sources)]

    def _listen(
        self,
        kind: type,
        topic: Callable[[int], str],
        add: Callable[[int, bytes], list[Row]],
        birds: Iterable[int],
    ) -> list[Source]:
        return [Source(self.subscribe_drained(kind, topic(bird)), add, bird) for bird in birds]

    def drain(self) -> bool:
        """Take all messages; return whether any was accepted."""
        ignored, taken = self.assembler.ignored, 0
        while (data := self._grants.take()) is not None:
            taken += 1
            self._hear_grant(data)
        while (data := self._perturbations.take()) is not None:
            taken += 1
            self._hear_perturbation(data)
        if self._joined:
            taken += self._take_rows()
        else:
            self._make_room()
            self._join()
        return taken > self.assembler.ignored - ignored

    def _take_rows(self) -> int:
        """Take the messages that make up rows; return their number.

        No row is complete before every bird has sent its state. So the recorder waits for the next
        bird whose state is missing, and looks at all other topics only every LOOK_EVERY s.
        """
        taken = 0
        while (data := self._times.take()) is not None:
            taken += 1
            self._add(self.assembler.add_time, data)
        thorough = self._all_due()
        if thorough or self.assembler.lacks_wings:
            taken += sum(map(self._take_all, self._wings))
        for _ in self._sources:
            source = self._sources[self._place]
            came = self._take_all(source)
            taken += came
            due = self._place < self._states and self.assembler.lacks_state(source.bird)
            if due and not (came or thorough):
                break
            self._place = (self._place + 1) % len(self._sources)
        return taken

    def _all_due(self) -> bool:
        """Whether the next look at all topics is due."""
        now = time.monotonic()
        due = now >= self._look_at
        if due:
            self._look_at = now + LOOK_EVERY
        return due

    def _take_all(self, source: Source) -> int:
        """Take all messages of one topic; return their number."""
        taken = 0
        while (data := source.inlet.take()) is not None:
            taken += 1
            self._add(source.add, source.bird, data)
        return taken

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
        """Repeat the progress report, for a clock that was restarted."""
        if self._joined:
            self._tell(self._run.saved)

    def keep_safe(self) -> None:
        """Write rows to disk if they are many or have waited for LINGER, and report it."""
        if self._unsafe_since is not None:
            waited = time.monotonic() - self._unsafe_since
            if self.assembler.complete or self._rows >= self._rows_at_once or waited > LINGER:
                self._save()
                self._tell(self._run.saved)
        if self.assembler.complete_to(self._configuration.steps):
            self._run.close()

    @property
    def waiting_for(self) -> str:
        """What the recorder needs to continue, as text."""
        if self._session.epoch == NEVER:
            return "the clock's first grant"
        if not self._joined:
            return ", ".join(self._unfound()) or "the clock's perturbation"
        if self.assembler.complete:
            return "the clock's word that the run is over"
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
            self._run.write_grant(data)
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
        self._not_found = [source.inlet for source in (*self._wings, *self._sources)]
        self._join()

    def _join(self) -> None:
        """Publish where the epoch begins, once every bird's topics have been discovered.

        Otherwise messages latched by a bird would be lost to us when it ends.
        """
        told = self._wanted in (0, *self._run.live, *self._asked)
        if self._session.epoch != NEVER and told and (self.assembler.complete or self._found_all()):
            self._joined = self._session.flying = True
            self._place, self._look_at = 0, 0.0
            self._write_push()
            self._checkpoint.publish(self._where().encode())
            self._tell(self._run.saved)

    def _found_all(self) -> bool:
        """Whether every bird's topics have been discovered, and still exist."""
        lacking = self._not_found
        while lacking and lacking[-1].connected:
            lacking.pop()
        return not (lacking or self._unfound())

    def _make_room(self) -> None:
        """Drop messages that belong to no epoch of ours before they fill a queue.

        Wings stay: each is sent only once, and our run may not be known yet.
        """
        if self._all_due():
            for inlet in (self._times, *(source.inlet for source in self._sources)):
                while inlet.take() is not None:
                    pass

    def _hear_perturbation(self, data: bytes) -> None:
        """Keep a push that was requested in flight until an epoch begins with it."""
        try:
            push = messages.Push.decode(data)
        except ValueError:
            self.assembler.ignored_for[MALFORMED] += 1
            return
        reason = refuses_push(push, self._configuration, self._run.saved)
        if self._session.run_id not in (0, push.run_id):
            reason = FOREIGN
        if not reason and push.number in self._run.live:
            reason = REPEATED
        if reason:
            self.assembler.ignored_for[reason] += 1
            return
        self._asked[push.number] = push
        if len(self._asked) > MOST_ASKED:
            del self._asked[next(iter(self._asked))]

    def _write_push(self) -> None:
        """Write the push that this epoch begins with to disk, and drop all others."""
        push = self._asked.pop(self._wanted, None)
        self._asked.clear()
        if push is not None and push.run_id == self._session.run_id and not self._run.closed:
            self._run.write_perturbation(push)
            self._save()

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
        )

    def _unfound(self) -> list[str]:
        """Return the names of the nodes with a topic that has not been discovered."""
        sources = (*self._wings, *self._sources)
        inlets = [(source.inlet, topics.bird_name(source.bird)) for source in sources]
        inlets.append((self._times, "the clock"))
        return sorted({who for inlet, who in inlets if not inlet.connected})

    def _hear_wing(self, bird: int, data: bytes) -> list[Row]:
        wing = messages.Wing.decode(data)
        if wing.run_id != self._session.run_id:
            self.assembler.ignored_for[FOREIGN] += 1
            return []
        if not np.array_equal(wing.span_ratio, self._configuration.span_ratio[bird - 1]):
            raise FlockError(
                f"{topics.bird_name(bird)} flies with span ratio {wing.span_ratio} and the "
                f"recorder is told {self._configuration.span_ratio[bird - 1]}: give both the same "
                "configuration"
            )
        return self.assembler.add_wing(bird, data)

    def _add(self, add: Callable[..., list[Row]], *what: object) -> None:
        try:
            self._write(add(*what))
        except ValueError:
            self.assembler.ignored_for[MALFORMED] += 1

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


def work(process: Process) -> None:
    """Record one flight."""
    configuration, operation = process.configuration, process.operation
    stages, factor = operation["record_stages"], operation["real_time_factor"]
    if factor:
        check_free(configuration, factor, operation["timeout"], stages)
    topics.steps_ahead(configuration, stages)  # refuses what can't be recorded
    if not operation["output"]:
        raise FlockError("output is not given: name a directory, as in -p output:=runs/mine")
    output = Path(operation["output"])
    if operation["played"]:
        check_played(operation)
    with ExitStack() as owned:
        resume, replace = _own(process, output, owned)
        if operation["played"]:
            record_played(process, output, replace)
            return
        run = owned.enter_context(
            recording(
                output,
                configuration,
                grants=True,
                stages=stages,
                resume=resume,
                replace=replace,
                factor=factor,
            )
        )
        executor = owned.enter_context(executing(operation["executor"], process.context))
        if run.bag.aside is not None:
            kept = run.bag.aside.name
            note(f"{run.bag.path} is damaged or lacks steps, and is kept as {kept}")
        if factor and run.saved >= 0:
            raise FlockError(f"output {output}: {GONE}; name another output, or give force:=true")
        services = not process.supervised
        node = RecorderNode(
            configuration,
            run,
            operation["run_id"],
            stages,
            factor=factor,
            context=process.context,
            services=services,
        )
        if services:
            own = ("output", "force", "resume", "record_stages", *OF_ALL)
            declare(node, configuration, operation, own)
        executor.add_node(node)
        process.settle()
        record(node, executor, process.stop, process.watchdog())


def _own(process: Process, output: Path, owned: ExitStack) -> tuple[bool, bool]:
    """Own the output; return whether to continue the existing bag, and whether to replace it.

    Under `fly`, the process of `fly` owns the output and has begun the bag. Raises FlockError if
    the output can't be used, and RunFailed if the bag that `fly` has begun is gone.
    """
    operation = process.operation
    if process.supervised and operation["resume"]:
        if not output.is_dir() or recorded_in(output) is None:
            raise RunFailed(f"recording to {output} failed: it was removed or moved")
        return True, False
    if operation["resume"] and output.is_dir():
        owned.enter_context(own_bag(output))
        return True, False
    if output.exists() and not operation["force"]:
        raise FlockError(
            f"output {output} exists: go on with it by -p resume:=true, replace it by "
            "-p force:=true, or name another output"
        )
    return False, owned.enter_context(own_output(output, operation["force"])).replaces


_main = run_node(
    "recorder",
    "The recorder of a flock as a ROS 2 node: writes a rosbag2 bag (MCAP) of one flight and ends\n"
    "with it.\n\n"
    "parameters: output (a directory), force (replace what is there) or resume (go on with the\n"
    "bag that is there, or begin one), played (record what ./flock play publishes, in a bag as\n"
    "reference writes it; give it the configuration that was flown), record_stages, run_id,\n"
    "timeout (s without news), executor (events|single), and all keys of the configuration file.",
    "  ./flock recorder --ros-args -p output:=runs/mine --params-file flock.yaml\n"
    "  ./flock recorder --ros-args -p output:=runs/mine -p resume:=true --params-file flock.yaml\n"
    "  ./flock recorder --ros-args -p output:=runs/again -p played:=true --params-file flock.yaml",
    work,
)


def main() -> int:
    """Run the `recorder` executable."""
    return _main(None)


if __name__ == "__main__":
    sys.exit(main())
