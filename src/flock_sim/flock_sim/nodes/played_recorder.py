# SPDX-License-Identifier: Apache-2.0
"""The recorder of a flight that is played: what `flock play` publishes becomes an equal bag.

Recorded states are of no run: whoever has flown them, they are the same bytes. So this recorder
follows no clock and says nothing to anybody: it takes the states of run 0, in their order, until
it has them all. Its bag is one as `reference` writes it.
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
from flock_sim.command_line import note
from flock_sim.core import messages, topics
from flock_sim.core.configuration import FlockConfiguration
from flock_sim.core.ledger import Ledger, Row
from flock_sim.core.terms import agree
from flock_sim.errors import FlockError, RunFailed
from flock_sim.nodes.endpoints import DrainedNode
from flock_sim.nodes.process import Process, executing
from flock_sim.recording import Recording, recording

WAIT = 0.004
"""How long the recorder rests when nothing came, in s."""


class PlayedRecorderNode(DrainedNode):
    """Moves what is played from the topics through a ledger into the bag."""

    def __init__(self, configuration: FlockConfiguration, run: Recording, context: Context) -> None:
        """Listen to what is played of a flock of `configuration`, and to the pushes it got."""
        super().__init__(
            topics.RECORDER,
            namespace=topics.NAMESPACE,
            context=context,
            start_parameter_services=False,
            enable_rosout=False,
        )
        self.ledger = Ledger(configuration, played=True)
        self._configuration = configuration
        self._run = run
        self._heard: dict[int, int] = {}  # the last step that was heard of each bird
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
        """Whether somebody plays every topic that is recorded."""
        inlets = [self._times, *(inlet for inlet, _, _ in self._sources)]
        return all(inlet.connected for inlet in inlets)

    @property
    def waiting_for(self) -> str:
        """What the recorder needs to go on, in words."""
        if not self.connected:
            return "somebody who plays all birds and /clock"
        names = ", ".join(topics.bird_name(bird) for bird in self.ledger.waiting_for)
        return f"step {self.ledger.saved + self._configuration.record_every} of {names or '/clock'}"

    def drain(self) -> bool:
        """Take everything that has come; return whether anything has.

        Raises FlockError where another flock is played, RunFailed where something was missed.
        """
        taken = 0
        while (data := self._grants.take()) is not None:
            taken += self._take(self._hear_grant, data)
        while (data := self._pushes.take()) is not None:
            taken += self._take(self._hear_push, data)
        while (data := self._times.take()) is not None:
            taken += self._take(self.ledger.add_time, data)
        for inlet, hear, bird in self._sources:
            while (data := inlet.take()) is not None:
                taken += self._take(hear, bird, data)
        return taken > 0

    def _take(self, hear: Callable[..., list[Row]], *what: object) -> int:
        """Write what is complete with a message; return 1. One that no flock sends is left out."""
        with suppress(ValueError):
            for row in hear(*what):
                self._run.write_row(row)
        return 1

    def _hear_grant(self, data: bytes) -> list[Row]:
        """Raises FlockError where what is played, and has grants, is not what we are told."""
        agree("the recorder", self._configuration, messages.Grant.decode(data).terms, 0.0)
        return []

    def _hear_push(self, data: bytes) -> list[Row]:
        push = messages.Push.decode(data)
        if push.number not in self._run.live:
            self._run.write_perturbation(push)
        return []

    def _hear_wing(self, bird: int, data: bytes) -> list[Row]:
        played = messages.Wing.decode(data).span_ratio
        told = self._configuration.span_ratio[bird - 1]
        if not np.array_equal(played, told):
            raise FlockError(
                f"{topics.bird_name(bird)} is played with span ratio {played} and the recorder is "
                f"told {told}: give it the configuration that was flown"
            )
        return self.ledger.add_wing(bird, data)

    def _hear_state(self, bird: int, data: bytes) -> list[Row]:
        rows = self.ledger.add_state(bird, data)
        if messages.State.envelope(data) == (0, 0):  # else it is flown, by somebody else
            step, every = messages.State.step_of(data), self._configuration.record_every
            last = self._heard.get(bird, -every)
            if step > last + every:
                raise RunFailed(
                    f"{topics.bird_name(bird)} is at step {step}, and step {last + every} was not "
                    "heard: start the recorder first, then play the whole bag, of a flight with "
                    f"record_every {every}"
                )
            self._heard[bird] = max(step, last)
        return rows


def check_played(operation: Mapping[str, Any]) -> None:
    """Raise FlockError where something is asked for that there is not when a flight is played."""
    for name in ("resume", "record_stages", "real_time_factor", "run_id"):
        if operation[name]:
            raise FlockError(
                f"{name} = {operation[name]} with played: a flight in lockstep that is played is "
                f"recorded from its beginning, without stages; leave {name} out"
            )


def record_played(process: Process, output: Path) -> None:
    """Record a flight that is played into `output`, until it is whole or `process` is to stop.

    Raises RunFailed where a state was missed, or nothing comes for long.
    """
    configuration, patience, connected = process.configuration, process.patience(), False
    with (
        recording(output, configuration, grants=False, live=True) as run,
        executing(process.operation["executor"], process.context) as executor,
    ):
        node = PlayedRecorderNode(configuration, run, process.context)
        executor.add_node(node)
        process.settle()
        while not process.stop and not node.ledger.complete:
            if node.drain():
                patience.renew()
                continue
            executor.spin_once(timeout_sec=WAIT)
            if node.connected and not connected:
                connected = True
                note("all birds and /clock are heard")
            patience.wait(lambda: f"the recorder waits for {node.waiting_for}")
