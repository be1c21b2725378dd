# SPDX-License-Identifier: Apache-2.0
"""Birds that fly freely as ROS 2 nodes: each steps when it is time, on what DDS has brought."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

from rclpy.executors import Executor

from flock_interfaces.msg import BirdAges, BirdStage, BirdState, BirdWing
from flock_sim.core import topics
from flock_sim.core.configuration import FlockConfiguration
from flock_sim.core.free_bird import FreeBird
from flock_sim.core.protocol import Channel
from flock_sim.nodes.bird import BirdNode
from flock_sim.nodes.drain import REPORT_EVERY
from flock_sim.nodes.patience import Patience
from flock_sim.nodes.process import new_life
from flock_sim.stop import Stop

REST = 0.02
"""The longest, in s, that a process of birds rests: grants may lie so long."""


class FreeBirdNode(BirdNode):
    """A bird that flies freely: moves messages between a `FreeBird` and its topics."""

    def __init__(
        self,
        bird: int,
        configuration: FlockConfiguration,
        run_id: int,
        factor: float,
        **options: Any,
    ) -> None:
        """Put bird 1..N on its topics; `options` are those of a `BirdNode`."""
        self._free = FreeBird(bird, configuration, factor, run_id, new_life())
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
        """When its next step is due, by the monotonic clock in s."""
        return self._free.due

    def tick(self) -> bool:
        """Take the step that is due, if one is, on all that has come; return whether one was."""
        if time.monotonic() < self._free.due:
            return False
        self._take_all_stages()
        self._send(self._free.tick(time.monotonic()))
        return True

    def _take_all_stages(self) -> bool:
        """Take what neighbours have said; before it is known of which run it must be, leave it."""
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
    patience: Patience,
    look_around: Callable[[], bool],
) -> None:
    """Let each of `birds` take its steps when they are due, to the end of the flight.

    Between them the executor waits. Calls `look_around` all the time; it returns whether anything
    came. Returns early on `stop`. Raises RunFailed when `patience` runs out, or somebody has died.
    """
    reports = 0
    while not stop:
        moved = look_around()
        for bird in birds:
            moved |= bird.drain_rare()
            moved |= bird.tick()
        if moved:
            patience.renew()
            reports = 0
        elif all(bird.finished for bird in birds):
            return
        rest = min(bird.due for bird in birds) - time.monotonic()
        executor.spin_once(timeout_sec=min(max(rest, 0.0), REST))
        if patience.silence > REPORT_EVERY * (reports + 1):
            reports += 1
            for bird in birds:
                bird.report()
        patience.wait(lambda: next(bird.waiting_for for bird in birds if not bird.finished))
