# SPDX-License-Identifier: Apache-2.0
"""Birds of a free flight as ROS 2 nodes: each steps by timer, with the latest messages."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

from rclpy.executors import Executor

from flock_interfaces.msg import BirdAges, BirdStage, BirdState, BirdWing
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.console.signals import Stop
from flock_sim.messages import topics
from flock_sim.nodes.bird import BirdNode
from flock_sim.protocol.free_bird import FreeBird
from flock_sim.protocol.session import Channel
from flock_sim.ros.process import new_incarnation
from flock_sim.ros.spin import REPORT_EVERY
from flock_sim.ros.watchdog import Watchdog

REST = 0.02
"""Longest wait of a process of birds, in s: the longest delay of a grant."""


class FreeBirdNode(BirdNode):
    """A bird of a free flight: moves messages between a `FreeBird` and its topics."""

    def __init__(
        self,
        bird: int,
        configuration: FlockConfiguration,
        run_id: int,
        factor: float,
        **options: Any,
    ) -> None:
        """Put bird 1..N on its topics; `options` are those of a `BirdNode`."""
        self._free = FreeBird(bird, configuration, factor, run_id, new_incarnation())
        outlets = {
            Channel.WING: (BirdWing, topics.wing_topic(bird)),
            Channel.STAGE: (BirdStage, topics.stage_topic(bird)),
            Channel.STATE: (BirdState, topics.state_topic(bird)),
            Channel.AGES: (BirdAges, topics.ages_topic(bird)),
        }
        super().__init__(
            bird, configuration, run_id, protocol=self._free, outlets=outlets, **options
        )

    @property
    def due(self) -> float:
        """Time at which its next step is due, by the monotonic clock, in s."""
        return self._free.due

    def tick(self) -> bool:
        """Take the step that is due, with all received messages; return whether one was due."""
        if time.monotonic() < self._free.due:
            return False
        self._take_all_stages()
        self._send(self._free.tick(time.monotonic()))
        return True

    def _take_all_stages(self) -> bool:
        """Take the neighbours' messages; leave them in the queues while the run is unknown."""
        free = self._free
        ignored, taken = free.ignored, 0
        if free.joined:
            for inlet in self._stages.values():
                while (message := inlet.take_with_age()) is not None:
                    taken += 1
                    data, age = message
                    self._send(free.receive_stage(data, time.monotonic() - age))
        return taken > free.ignored - ignored


def keep_ticking(
    birds: Sequence[FreeBirdNode],
    executor: Executor,
    stop: Stop,
    watchdog: Watchdog,
    look_around: Callable[[], bool],
) -> None:
    """Let each of `birds` take its steps when they are due, to the end of the flight.

    The executor waits between steps. Each turn calls `look_around`, which returns whether a message
    came. Returns early on `stop`. Raises RunFailed if `watchdog` runs out or a node has died.
    """
    reports = 0
    while not stop:
        moved = look_around()
        for bird in birds:
            moved |= bird.drain_rare()
            moved |= bird.tick()
        if moved:
            watchdog.reset()
            reports = 0
        elif all(bird.finished for bird in birds):
            return
        rest = min(bird.due for bird in birds) - time.monotonic()
        executor.spin_once(timeout_sec=min(max(rest, 0.0), REST))
        if watchdog.silence > REPORT_EVERY * (reports + 1):
            reports += 1
            for bird in birds:
                bird.report()
        watchdog.wait(lambda: next(bird.waiting_for for bird in birds if not bird.finished))
