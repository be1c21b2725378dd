# SPDX-License-Identifier: Apache-2.0
"""The recorder as a ROS 2 node: puts every recorded state on disk, and says how far it has come.

What is on disk is the checkpoint: at the beginning of an epoch it tells everybody where that is.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path

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
from flock_sim.bag.output import claim_output
from flock_sim.core import messages, topics
from flock_sim.core.configuration import FlockConfiguration
from flock_sim.core.free_flight import GONE, NO_WAY_BACK, check_free
from flock_sim.core.ledger import Ledger, Row
from flock_sim.core.stage_inbox import FOREIGN, MALFORMED, NEVER, STALE
from flock_sim.core.terms import agree
from flock_sim.errors import FlockError, RunFailed
from flock_sim.nodes.complaints import Complaints
from flock_sim.nodes.diagnostics import Diagnostics, Status, ignored
from flock_sim.nodes.endpoints import DrainedNode, latched
from flock_sim.nodes.parameters import OF_ALL, declare
from flock_sim.nodes.patience import Patience
from flock_sim.nodes.played_recorder import check_played, record_played
from flock_sim.nodes.process import Process, executing, new_life, run_node
from flock_sim.recording import Recording, recording
from flock_sim.stop import Stop

WAIT = 0.004
"""How long the recorder rests when nothing came, in s: many messages are cheaper at a time."""

REPORT_EVERY = 1.0
"""How often, in s, a recorder that waits says how far it has come."""

GOODBYE = 10.0
"""How long, in s, a recorder that has everything stays for a clock that does not know it yet."""

LINGER = 0.5
"""How long, in s, a row that is complete may stay off the disk when no others follow."""


class RecorderNode(DrainedNode):
    """The recorder: moves messages from the topics through a ledger into the bag."""

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
        """Listen to a flock of `configuration`; `run_id` 0: that of the first grant heard.

        `factor` is the real-time factor of a free flight. `services`: with rosout and those for
        parameters.
        """
        super().__init__(
            topics.RECORDER,
            namespace=topics.NAMESPACE,
            context=context,
            start_parameter_services=services,
            enable_rosout=services,
        )
        self.ledger = Ledger(configuration, record_stages, run.saved, factor > 0.0)
        self.released = False
        """Whether the clock has said that the run is over."""
        self._configuration = configuration
        self._factor = factor
        self._run = run
        self._run_id = run_id
        self._epoch = NEVER
        self._leave: tuple[int, int] = (NEVER, 0)  # epoch and step of the last grant
        self._life = new_life()
        self._joined = False  # has told everybody where the epoch begins
        self._unsafe_since: float | None = None
        self._rows = 0
        self._rows_at_once = max(
            1, topics.steps_ahead(configuration, record_stages) // configuration.record_every // 4
        )
        self._progress = self.create_publisher(Progress, topics.PROGRESS_TOPIC, latched(1))
        self._checkpoint = self.create_publisher(Checkpoint, topics.CHECKPOINT_TOPIC, latched(1))
        self._grants = self.subscribe_drained(Grant, topics.GRANT_TOPIC)
        self._times = self.subscribe_drained(Clock, topics.CLOCK_TOPIC)
        self._perturbations = self.subscribe_drained(Perturbation, topics.PERTURBATION_TOPIC)
        self._wanted = 0  # number of the last perturbation that this epoch is to know
        self._complaints = Complaints(self.get_name(), self.ledger.ignored_for)
        self._diagnostics = Diagnostics(self)
        birds = range(1, configuration.birds + 1)
        sources: list[tuple[type, Callable[[int], str], Callable[[int, bytes], list[Row]]]] = [
            (BirdWing, topics.wing_topic, self._hear_wing),
            (BirdState, topics.state_topic, self.ledger.add_state),
        ]
        if factor:
            sources.append((BirdAges, topics.ages_topic, self.ledger.add_ages))
        else:
            sources.append((BirdMemory, topics.memory_topic, self.ledger.add_memory))
        if record_stages:
            sources.append((BirdStage, topics.stage_topic, self.ledger.add_stage))
        self._sources = [
            (self.subscribe_drained(kind, topic(bird)), add, bird)
            for kind, topic, add in sources
            for bird in birds
            if kind is not BirdMemory or configuration.linkage.remembers(bird)
        ]

    def drain(self) -> bool:
        """Take everything that has come; return whether any of it was of this run."""
        ignored, taken = self.ledger.ignored, 0
        while (data := self._grants.take()) is not None:
            taken += 1
            self._hear_grant(data)
        while (data := self._perturbations.take()) is not None:
            taken += 1
            self._hear_perturbation(data)
        if self._joined:
            for inlet, add, bird in self._sources:
                while (data := inlet.take()) is not None:
                    taken += 1
                    self._add(add, bird, data)
            while (data := self._times.take()) is not None:
                taken += 1
                self._add(self.ledger.add_time, data)
        else:
            self._make_room()
            self._join()
        return taken > self.ledger.ignored - ignored

    @property
    def finished(self) -> bool:
        """Whether all is on disk, and the clock knows."""
        return self.ledger.complete and self.released

    def look_around(self) -> None:
        """Tell of what is amiss, and how far the recorder has come."""
        self._complaints.tell()
        self._diagnostics.tell(self._status)

    def report(self) -> None:
        """Say again how far it has come: a clock that was started again does not know."""
        if self._joined:
            self._tell(self._run.saved)

    def keep_safe(self) -> None:
        """Put on disk what has waited long enough, or is enough, and say so."""
        if self._unsafe_since is not None:
            waited = time.monotonic() - self._unsafe_since
            if self.ledger.complete or self._rows >= self._rows_at_once or waited > LINGER:
                self._save()
                self._tell(self._run.saved)
        if self.ledger.complete:
            self._run.close()

    @property
    def waiting_for(self) -> str:
        """What the recorder needs to go on, in words."""
        if self._epoch == NEVER:
            return "the clock's first grant"
        if not self._joined:
            return ", ".join(self._unfound()) or "the clock's perturbation"
        if self.ledger.complete:
            return "the clock's word that the run is over"
        names = [topics.bird_name(bird) for bird in self.ledger.waiting_for]
        return ", ".join(names) or "the clock"

    def _save(self) -> None:
        self._run.flush()
        self._unsafe_since, self._rows = None, 0

    def _hear_grant(self, data: bytes) -> None:
        try:
            grant = messages.Grant.decode(data)
            foreign = self._run_id not in (0, grant.run_id)
            if foreign or grant.epoch < self._epoch:
                self.ledger.ignored_for[FOREIGN if foreign else STALE] += 1
                return
            if self._epoch == NEVER:
                agree("the recorder", self._configuration, grant.terms, self._factor)
        except ValueError:
            self.ledger.ignored_for[MALFORMED] += 1
            return
        if grant.epoch > self._epoch:
            self.released = False
            self._begin(grant)
        self.released |= grant.step > grant.end
        self.ledger.end_at(grant.end)
        if (grant.epoch, grant.step) > self._leave and not self.ledger.complete:
            self._leave = (grant.epoch, grant.step)
            self._run.write_grant(data)

    def _begin(self, grant: messages.Grant) -> None:
        """Begin an epoch: what is complete goes on disk, what is not comes again.

        Raises RunFailed in a free flight that has begun: what was can't come again.
        """
        if self._factor and self._leave[1] > 0:
            raise RunFailed(f"the recorder: {NO_WAY_BACK}")
        self._run_id, self._epoch = grant.run_id, grant.epoch
        self._wanted = grant.perturbation
        if not self.ledger.complete:
            self._save()
        self.ledger.begin(self._run_id, self._epoch)
        self._joined = False
        self._join()

    def _join(self) -> None:
        """Say where the epoch begins, once every bird's topics have been found.

        A bird that ends would otherwise take along what it had latched for us.
        """
        told = self._wanted in (0, *self._run.live)
        if self._epoch != NEVER and told and (self.ledger.complete or not self._unfound()):
            self._joined = True
            self._checkpoint.publish(self._where().encode())
            self._tell(self._run.saved)

    def _make_room(self) -> None:
        """Take what is of no epoch of ours, before a queue is full of it.

        Wings stay: they are said once, and it may not be known yet whose they must be.
        """
        flowing = (inlet for inlet, add, _ in self._sources if add != self._hear_wing)
        for inlet in (self._times, *flowing):
            while inlet.take() is not None:
                pass

    def _hear_perturbation(self, data: bytes) -> None:
        """Put on disk a push that was asked for in flight."""
        try:
            push = messages.Push.decode(data)
        except ValueError:
            self.ledger.ignored_for[MALFORMED] += 1
            return
        if push.run_id != self._run_id:
            self.ledger.ignored_for[FOREIGN] += 1
        elif push.number not in self._run.live and not self.ledger.complete:
            self._run.write_perturbation(push)
            self._save()

    def _where(self) -> messages.Checkpoint:
        """Return the checkpoint of this epoch: the last row on disk."""
        states = [messages.State.decode(data) for data in self._run.checkpoint]
        memories = [messages.Memory.decode(data) for data in self._run.memories]
        pushes = " ".join(str(push) for push in self._run.live.values())
        if not states:
            return messages.Checkpoint.of_start(self._run_id, self._epoch, pushes)
        return messages.Checkpoint(
            self._run_id,
            self._run.saved,
            self._epoch,
            np.concatenate([state.position for state in states]),
            np.concatenate([state.speed for state in states]),
            pushes,
            np.concatenate([np.empty(0), *(memory.data for memory in memories)]),
        )

    def _unfound(self) -> list[str]:
        """Return who has a topic that has not been found yet."""
        inlets = [(inlet, topics.bird_name(bird)) for inlet, _, bird in self._sources]
        inlets.append((self._times, "the clock"))
        return sorted({who for inlet, who in inlets if not inlet.connected})

    def _hear_wing(self, bird: int, data: bytes) -> list[Row]:
        wing = messages.Wing.decode(data)
        if wing.run_id != self._run_id:
            self.ledger.ignored_for[FOREIGN] += 1
            return []
        if not np.array_equal(wing.span_ratio, self._configuration.span_ratio[bird - 1]):
            raise FlockError(
                f"{topics.bird_name(bird)} flies with span ratio {wing.span_ratio} and the "
                f"recorder is told {self._configuration.span_ratio[bird - 1]}: give both the same "
                "configuration"
            )
        return self.ledger.add_wing(bird, data)

    def _add(self, add: Callable[..., list[Row]], *what: object) -> None:
        try:
            self._write(add(*what))
        except ValueError:
            self.ledger.ignored_for[MALFORMED] += 1

    def _write(self, rows: list[Row]) -> None:
        for row in rows:
            self._run.write_row(row)
            self._rows += 1
            if self._unsafe_since is None:
                self._unsafe_since = time.monotonic()

    def _tell(self, step: int) -> None:
        progress = messages.Progress(self._run_id, step, self._epoch, topics.RECORDER, self._life)
        self._progress.publish(progress.encode())

    def _status(self) -> Status:
        saved = self._run.saved
        words = f"step {saved} of {self._configuration.steps} is on disk"
        return (
            self._joined,
            words if self._joined else f"waiting for {self.waiting_for}",
            {"saved": saved, "epoch": self._epoch, **ignored(self.ledger.ignored_for)},
        )


def record(node: RecorderNode, executor: Executor, stop: Stop, patience: Patience) -> None:
    """Record until every row is on disk and the clock knows, or is gone. Returns early on `stop`.

    Raises RunFailed when `patience` runs out, or the bag can't be written.
    """
    reports = 0
    while not stop and not node.finished:
        if node.drain():
            patience.renew()
            reports = 0
        else:
            executor.spin_once(timeout_sec=WAIT)
            if node.ledger.complete:
                if patience.silence > GOODBYE:
                    return
            else:
                patience.wait(lambda: f"the recorder waits for {node.waiting_for}")
        node.keep_safe()
        node.look_around()
        if patience.silence > REPORT_EVERY * (reports + 1):
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
    resume = operation["resume"] and output.is_dir()
    if output.exists() and not resume and not operation["force"]:
        raise FlockError(
            f"output {output} exists: go on with it by -p resume:=true, replace it by "
            "-p force:=true, or name another output"
        )
    if not resume:
        claim_output(output, operation["force"])
    if operation["played"]:
        record_played(process, output)
        return
    with (
        recording(
            output, configuration, grants=True, stages=stages, resume=resume, factor=factor
        ) as run,
        executing(operation["executor"], process.context) as executor,
    ):
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
        record(node, executor, process.stop, process.patience())


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
