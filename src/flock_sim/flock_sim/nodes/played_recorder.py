# SPDX-License-Identifier: Apache-2.0
"""The recorder of a played flight: it writes the messages of `flock play` to an equal bag.

Recorded states have run 0, so their bytes do not depend on the flight that produced them. So this
recorder follows no clock and publishes nothing: it takes the states of run 0, in order, until it
has all. Its bag has the form of one that `reference` writes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from rclpy.context import Context
from rosgraph_msgs.msg import Clock

from flock_interfaces.msg import BirdState, BirdWing, Grant, Perturbation
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.errors import FlockError, RunFailed
from flock_sim.messages import topics
from flock_sim.messages import types as messages
from flock_sim.messages.epochs import NEVER
from flock_sim.messages.handshake import check_handshake
from flock_sim.messages.rejection import REPEATED
from flock_sim.nodes.own_birds import announced
from flock_sim.protocol.requests import refuses_push
from flock_sim.recording.flight_writer import Recording, recording
from flock_sim.recording.own_parts import add_parts
from flock_sim.recording.row_assembler import Row, RowAssembler
from flock_sim.ros.endpoints import DrainedNode
from flock_sim.ros.process import Process, executing

WAIT = 0.004
"""Wait of the recorder when no message has come, in s."""


class PlayedRecorderNode(DrainedNode):
    """Moves played messages from the topics through a row assembler into the bag."""

    def __init__(self, configuration: FlockConfiguration, run: Recording, context: Context) -> None:
        """Subscribe to the played states and pushes of a flock of `configuration`."""
        super().__init__(
            topics.RECORDER,
            namespace=topics.NAMESPACE,
            context=context,
            start_parameter_services=False,
            enable_rosout=False,
        )
        self.assembler = RowAssembler(configuration, played=True)
        self._configuration = configuration
        self._run = run
        self._heard: dict[int, int] = {}  # the last step received from each bird
        self._pushes = self.subscribe_drained(Perturbation, topics.PERTURBATION_TOPIC)
        self._grants = self.subscribe_drained(Grant, topics.GRANT_TOPIC)
        self._times = self.subscribe_drained(Clock, topics.CLOCK_TOPIC)
        birds = range(1, configuration.birds + 1)
        sources: list[tuple[type, Callable[[int], str], Callable[[int, bytes], list[Row]]]] = [
            (BirdWing, topics.wing_topic, self._hear_wing),
            (BirdState, topics.state_topic, self._hear_state),
        ]
        self._sources = [
            (self.subscribe_drained(kind, topic(bird)), hear, bird)
            for kind, topic, hear in sources
            for bird in birds
        ]

    @property
    def connected(self) -> bool:
        """Whether every recorded topic has a publisher."""
        inlets = [self._times, *(inlet for inlet, _, _ in self._sources)]
        return all(inlet.connected for inlet in inlets)

    @property
    def waiting_for(self) -> str:
        """What the recorder needs to continue, as text."""
        if not self.connected:
            return "a player that publishes all birds and /clock"
        names = ", ".join(topics.bird_name(bird) for bird in self.assembler.waiting_for)
        return (
            f"step {self.assembler.saved + self._configuration.record_every} of {names or '/clock'}"
        )

    def drain(self) -> bool:
        """Take all messages; return whether any came.

        Raises FlockError if another flock is played, and RunFailed if a state was missed.
        """
        taken = 0
        while (data := self._grants.take()) is not None:
            taken += self._take(self._hear_grant, data)
        while (data := self._pushes.take()) is not None:
            taken += self._take(self._hear_push, data)
        while (data := self._times.take()) is not None:
            taken += self._take(self.assembler.add_time, data)
        for inlet, hear, bird in self._sources:
            while (data := inlet.take()) is not None:
                taken += self._take(hear, bird, data)
        return taken > 0

    def _take(self, hear: Callable[..., list[Row]], *what: object) -> int:
        """Write the rows that a message completes; return 1. A malformed message is ignored."""
        with suppress(ValueError):
            for row in hear(*what):
                self._run.write_row(row)
        return 1

    def _hear_grant(self, data: bytes) -> list[Row]:
        """Raise FlockError if a played grant does not match our configuration."""
        check_handshake("the recorder", self._configuration, messages.Grant.decode(data).terms, 0.0)
        return []

    def _hear_push(self, data: bytes) -> list[Row]:
        push = messages.Push.decode(data)
        refused = refuses_push(push, self._configuration, NEVER)
        if not refused and push.number not in self._run.live:
            self._run.write_perturbation(push)
        return []

    def _hear_wing(self, bird: int, data: bytes) -> list[Row]:
        played = messages.Wing.decode(data).span_ratio
        told = self._configuration.span_ratio[bird - 1]
        if not np.array_equal(played, told):
            raise FlockError(
                f"{topics.bird_name(bird)} is played with span ratio {played} and the recorder has "
                f"{told}: give it the configuration of the played flight"
            )
        return self.assembler.add_wing(bird, data)

    def _hear_state(self, bird: int, data: bytes) -> list[Row]:
        refused = self._refused
        rows = self.assembler.add_state(bird, data)
        if self._refused == refused:  # otherwise it belongs to a flight in progress, or is invalid
            step, every = messages.State.step_of(data), self._configuration.record_every
            last = self._heard.get(bird, -every)
            if step > last + every:
                raise RunFailed(
                    f"{topics.bird_name(bird)} is at step {step}, but step {last + every} was not "
                    "received: start the recorder first, then play the whole bag of a flight with "
                    f"record_every {every}"
                )
            self._heard[bird] = max(step, last)
        return rows

    @property
    def _refused(self) -> int:
        """Number of messages that can't be of this flight, whatever their step."""
        return self.assembler.ignored - self.assembler.ignored_for[REPEATED]


def check_played(operation: Mapping[str, Any]) -> None:
    """Raise FlockError if an option is given that a played flight does not support."""
    for name in ("resume", "record_stages", "real_time_factor", "run_id"):
        if operation[name]:
            raise FlockError(
                f"{name} = {operation[name]} with played: a played flight in lockstep is "
                f"recorded from its beginning, without stages; leave {name} out"
            )


def record_played(process: Process, output: Path, replace: bool) -> None:
    """Record a played flight into `output`, until it is complete or `process` must stop.

    `replace`: an existing bag stays until the first state is on disk.

    Raises RunFailed if a state was missed, or if the watchdog runs out.
    """
    configuration, connected = process.configuration, False
    with (
        recording(output, configuration, grants=False, live=True, replace=replace) as run,
        executing(process.operation["executor"], process.context) as executor,
    ):
        node = PlayedRecorderNode(configuration, run, process.context)
        watchdog = process.watchdog(node)
        executor.add_node(node)
        process.settle()
        while not process.stop and not node.assembler.complete:
            if not connected and node.connected:
                connected = True
                add_parts(run.bag, announced(node))
                node.get_logger().info("the topics of all birds and /clock are found")
            if node.drain():
                watchdog.reset()
                continue
            executor.spin_once(timeout_sec=WAIT)
            watchdog.wait(lambda: f"the recorder waits for {node.waiting_for}")
