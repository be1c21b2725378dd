# SPDX-License-Identifier: Apache-2.0
"""The recorder as a ROS 2 node: puts every recorded state on disk, and says how far it has come."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from rclpy.context import Context
from rclpy.executors import Executor
from rosgraph_msgs.msg import Clock

from flock_interfaces.msg import BirdStage, BirdState, BirdWing, Grant, Progress
from flock_sim.bag.output import claim_output
from flock_sim.core import messages, topics
from flock_sim.core.configuration import FlockConfiguration
from flock_sim.core.ledger import Ledger, Row
from flock_sim.errors import FlockError
from flock_sim.nodes.endpoints import DrainedNode, Inlet, latched, wait_until_heard
from flock_sim.nodes.parameters import OF_ALL, declare
from flock_sim.nodes.patience import Patience
from flock_sim.nodes.process import Process, executing, run_node
from flock_sim.recording import Recording, recording
from flock_sim.stop import Stop

WAIT = 0.004
"""How long the recorder rests when nothing came, in s: many messages are cheaper at a time."""

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
        context: Context | None = None,
        services: bool = False,
    ) -> None:
        """Listen to a flock of `configuration`; `run_id` 0: that of the first grant heard.

        `services`: with rosout and those for parameters.
        """
        super().__init__(
            topics.RECORDER,
            namespace=topics.NAMESPACE,
            context=context,
            start_parameter_services=services,
            enable_rosout=services,
        )
        self.ledger = Ledger(configuration, record_stages)
        self._configuration = configuration
        self._run = run
        self._run_id = run_id
        self._epoch = 0
        self._joined = False
        self._unsafe_since: float | None = None
        self._rows = 0
        self._rows_at_once = max(
            1, topics.steps_ahead(configuration, record_stages) // configuration.record_every // 4
        )
        self._progress = self.create_publisher(Progress, topics.PROGRESS_TOPIC, latched(1))
        self._grants = self._inlet(Grant, topics.GRANT_TOPIC, configuration)
        self._times = self._inlet(Clock, topics.CLOCK_TOPIC, configuration)
        birds = range(1, configuration.birds + 1)
        sources: list[tuple[type, Callable[[int], str], Callable[[int, bytes], list[Row]]]] = [
            (BirdWing, topics.wing_topic, self._hear_wing),
            (BirdState, topics.state_topic, self.ledger.add_state),
        ]
        if record_stages:
            sources.append((BirdStage, topics.stage_topic, self.ledger.add_stage))
        self._sources = [
            (self._inlet(kind, topic(bird), configuration), add, bird)
            for kind, topic, add in sources
            for bird in birds
        ]

    def drain(self) -> bool:
        """Take everything that has come; return whether anything had."""
        moved = False
        while (data := self._grants.take()) is not None:
            moved = True
            self._hear_grant(data)
        if not self._joined:
            self._join()
            return moved  # what is latched can wait until it is known whose it must be
        for inlet, add, bird in self._sources:
            while (data := inlet.take()) is not None:
                moved = True
                self._write(add(bird, data))
        while (data := self._times.take()) is not None:
            moved = True
            self._write(self.ledger.add_time(data))
        return moved

    def keep_safe(self) -> None:
        """Put on disk what has waited long enough, or is enough, and say so."""
        if self._unsafe_since is None:
            return
        waited = time.monotonic() - self._unsafe_since
        if self.ledger.complete or self._rows >= self._rows_at_once or waited > LINGER:
            self._run.bag.flush()
            self._unsafe_since, self._rows = None, 0
            self._tell(self.ledger.saved)

    def farewell(self, stop: Stop) -> None:
        """Wait until the clock has heard that all is on disk, or `stop`."""
        wait_until_heard(self._progress, stop)

    @property
    def waiting_for(self) -> str:
        """What the recorder needs to go on, in words."""
        if not self._epoch:
            return "the clock's first grant"
        if not self._joined:
            return ", ".join(self._unfound())
        names = [topics.bird_name(bird) for bird in self.ledger.waiting_for]
        return ", ".join(names) or "the clock"

    def _inlet(self, kind: type, topic: str, configuration: FlockConfiguration) -> Inlet:
        return self.subscribe_drained(kind, topic, topics.depth(topic, configuration))

    def _hear_grant(self, data: bytes) -> None:
        grant = messages.Grant.decode(data)
        if self._run_id not in (0, grant.run_id):
            return
        if not self._epoch:
            self._run_id, self._epoch = grant.run_id, grant.epoch
            flown = self._configuration
            if grant.dt != flown.dt or grant.end != flown.steps:
                raise FlockError(
                    f"the clock flies {grant.end} steps of dt = {grant.dt:g} and the recorder is "
                    f"to record {flown.steps} of {flown.dt:g}: give both the same configuration"
                )
        self._run.write_grant(data)

    def _join(self) -> None:
        """Say that the flight may begin, once every bird's topics have been found.

        A bird that ends would otherwise take along what it had latched for us.
        """
        if self._epoch and not self._unfound():
            self._joined = True
            self._tell(self.ledger.saved)

    def _unfound(self) -> list[str]:
        """Return who has a topic that has not been found yet."""
        inlets = [(inlet, topics.bird_name(bird)) for inlet, _, bird in self._sources]
        inlets.append((self._times, "the clock"))
        return sorted({who for inlet, who in inlets if not inlet.connected})

    def _hear_wing(self, bird: int, data: bytes) -> list[Row]:
        wing = messages.Wing.decode(data)
        if wing.run_id != self._run_id:
            return []
        if not np.array_equal(wing.span_ratio, self._configuration.span_ratio[bird - 1]):
            raise FlockError(
                f"{topics.bird_name(bird)} flies with span ratio {wing.span_ratio} and the "
                f"recorder is told {self._configuration.span_ratio[bird - 1]}: give both the same "
                "configuration"
            )
        return self.ledger.add_wing(bird, data)

    def _write(self, rows: list[Row]) -> None:
        for row in rows:
            self._run.write_row(row)
            self._rows += 1
            if self._unsafe_since is None:
                self._unsafe_since = time.monotonic()

    def _tell(self, step: int) -> None:
        progress = messages.Progress(self._run_id, step, self._epoch, topics.RECORDER)
        self._progress.publish(progress.encode())


def record(node: RecorderNode, executor: Executor, stop: Stop, patience: Patience) -> None:
    """Record until every row is on disk. Returns early on `stop`.

    Raises RunFailed when `patience` runs out, or the bag can't be written.
    """
    while not stop and not node.ledger.complete:
        if node.drain():
            patience.renew()
        else:
            executor.spin_once(timeout_sec=WAIT)
            patience.wait(lambda: f"the recorder waits for {node.waiting_for}")
        node.keep_safe()


def work(process: Process) -> None:
    """Record one flight."""
    configuration, operation = process.configuration, process.operation
    stages = operation["record_stages"]
    topics.steps_ahead(configuration, stages)  # refuses what can't be recorded
    if not operation["output"]:
        raise FlockError("output is not given: name a directory, as in -p output:=runs/mine")
    output = Path(operation["output"])
    if not process.supervised:  # `fly` has claimed it before anything started
        claim_output(output, operation["force"])
    with (
        recording(output, configuration, grants=True, stages=stages) as run,
        executing(operation["executor"], process.context) as executor,
    ):
        services = not process.supervised
        node = RecorderNode(
            configuration,
            run,
            operation["run_id"],
            stages,
            context=process.context,
            services=services,
        )
        if services:
            declare(node, configuration, operation, ("output", "force", "record_stages", *OF_ALL))
        executor.add_node(node)
        record(node, executor, process.stop, process.patience())
        node.farewell(process.stop)


_main = run_node(
    "recorder",
    "The recorder of a flock as a ROS 2 node: writes a rosbag2 bag (MCAP) of one flight and ends\n"
    "with it.\n\n"
    "parameters: output (a directory), force (replace it), record_stages, run_id, timeout (s\n"
    "without news), executor (events|single), and all keys of the configuration file.",
    "  ./flock recorder --ros-args -p output:=runs/mine --params-file flock.yaml",
    work,
)


def main() -> int:
    """Run the `recorder` executable."""
    return _main(None)


if __name__ == "__main__":
    sys.exit(main())
