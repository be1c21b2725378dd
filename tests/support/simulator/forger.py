# SPDX-License-Identifier: Apache-2.0
"""Forged messages of the run of a simulated flight.

A message is forged only if its values are impossible, or if it does not come from a node of the
flight. Possible but false values can change a flight, since messages are not signed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from random import Random

from flock_sim.messages import topics
from flock_sim.messages.epochs import EPOCHS, NEVER, REACH
from flock_sim.messages.types import Checkpoint, Progress, Push, Stage
from flock_sim.protocol.clock import Timekeeper
from support.forgeries import KINDS, STAGE_HEADERS, STAGES_AHEAD, with_header
from support.simulator.recorder import RUN
from support.simulator.wires import Process
from support.simulator.world import CLOCK, World

FAR = (1, 2, 1000, REACH, 2**30, 2**31 - 1, 2**31, 2**32 - REACH, 2**32 - 1000)
"""Distances of forged epochs from those of the flight."""

ANOTHER_FLIGHT = "another flight of this run"
"""A kind of message that a flight need not survive if it is repeated."""


class Forger:
    """Forges messages of a world. `pushed`: pushes are requested in its flight."""

    def __init__(self, world: World, *, pushed: bool = False) -> None:
        self._world = world
        self._pushed = pushed
        self._done: set[str] = set()  # kinds that are not forged again

    @property
    def _random(self) -> Random:
        return self._world.random

    def anything(self) -> None:
        """Forge a message of any kind."""
        forge: Callable[[], None] = self._random.choice([self.epoch, self.message, self.stage])
        forge()

    def epoch(self) -> None:
        """Send some listeners a message with an epoch that no process of the flight has begun."""
        world, random = self._world, self._random
        known = [process.core._session.epoch for process in world.bird_processes]
        known += [world.keeper.epoch] if CLOCK in world.living else []
        epoch = random.choice([epoch for epoch in known if epoch != NEVER] or [1])
        epoch = (epoch + random.choice(FAR) + random.randint(-1, 1)) % EPOCHS or 1
        grant = Timekeeper(world.configuration, RUN, 1, False, epoch=epoch).grant
        progress = Progress(RUN, -1, epoch, random.choice(world.birds), 1)
        topic, message = random.choice(
            [(topics.GRANT_TOPIC, grant), (topics.PROGRESS_TOPIC, progress)]
        )
        world.post_forged(topic, message.encode())

    def message(self) -> None:
        """Send some listeners a message that is made from the last genuine ones."""
        genuine = self._world.genuine
        if topics.GRANT_TOPIC in genuine and topics.PROGRESS_TOPIC in genuine:
            kinds = sorted(KINDS.keys() - self._done)
            name = self._random.choice(kinds)
            topic, forge = KINDS[name]
            if name == ANOTHER_FLIGHT:
                self._done.add(name)
            message = forge(self._random, genuine)
            if isinstance(message, Push) and message.step > self._world.configuration.steps:
                step = self._random.randint(0, self._world.configuration.steps)
                message = replace(message, step=step)
            if not (isinstance(message, Checkpoint) and self._is_possible(message)):
                self._world.post_forged(
                    topic, message.encode(), latched=self._random.random() < 0.5
                )

    def stage(self) -> None:
        """Hand a stage over whose header is impossible: it has no effect, and is counted."""
        queues = [
            queue
            for queue in self._world.wires.queues
            if queue.topic.endswith("/stage") and queue.to in self._world.bird_processes
        ]
        if queues:
            queue = self._random.choice(queues)
            self._hand_over(queue.to, self._random.choice(queue.messages))

    def _hand_over(self, to: Process, data: bytes) -> None:
        bird = to.core
        name = self._random.choice(sorted(STAGE_HEADERS))
        flies = bird.in_flight and Stage.decode(data).epoch == bird._session.epoch
        if not flies and name in (*STAGES_AHEAD, "an older epoch"):
            return  # it may be possible in the epoch that the bird is in, or begins next
        before = bird.ignored
        forged = with_header(data, STAGE_HEADERS[name], bird, self._world.configuration)
        assert bird.receive_stage(forged) == [], f"a stage with {name} moved a bird"
        # A bird may keep it for the start of a later epoch, which never comes.
        assert bird.ignored == before + 1 or (not flies and bird.ignored == before)

    def _is_possible(self, checkpoint: Checkpoint) -> bool:
        """Whether birds that come to its epoch may begin from a checkpoint with false values.

        The start of the flight is true as long as no push is requested.
        """
        size = len(checkpoint.position)
        configuration = self._world.configuration
        return size == configuration.birds * configuration.members or (not size and self._pushed)
