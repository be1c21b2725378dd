# SPDX-License-Identifier: Apache-2.0
"""How many deliveries a simulated flight needs at most to its end, once all faults are over."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from flock_sim.messages import topics
from flock_sim.messages.epochs import NEVER
from flock_sim.messages.types import Grant, Progress
from flock_sim.physics.runge_kutta import STAGES

if TYPE_CHECKING:
    from support.simulator.world import World


def most_deliveries(world: World, epochs: int) -> int:
    """Return the bound Q + F(S) + E F(L) + (E + 2) H on the deliveries from now to the end.

    1. Q messages are in flight; S steps remain; E = `epochs` may begin, each after L lost steps.
    2. F(s) = K x + (2 P + R) s + (2 P + 2) R r for s steps: x exchanges over K links, at most one
       report and one grant of P birds and R recorders a step, and r rows (states, memories, time).
    3. H = 5 K + 7 (P + R): handshake and first exchange of an epoch, and two rounds of reports.
    """
    traffic = _Traffic.of(world)
    end = world.keeper.end
    remaining = max(0, end - max(0, world.disk.saved))
    lost = min(end, _most_lost(world))
    return (
        world.wires.in_flight
        + traffic.flight(world, remaining)
        + epochs * traffic.flight(world, lost)
        + (epochs + 2) * traffic.handshake
    )


@dataclass(frozen=True)
class _Traffic:
    birds: int
    recorders: int
    links: int
    """Number of deliveries of one stage of every bird."""

    @classmethod
    def of(cls, world: World) -> _Traffic:
        birds = world.bird_processes
        links = sum(len(world.listeners(topics.stage_topic(bird.core.bird))) for bird in birds)
        return cls(len(birds), int(world.record), links)

    @property
    def handshake(self) -> int:
        return 5 * self.links + 7 * (self.birds + self.recorders)

    def flight(self, world: World, steps: int) -> int:
        """Return the number of deliveries of a flight of so many steps, wherever it begins."""
        every_tick = world.configuration.link_table.exchange_schedule.every_tick
        exchanges = (STAGES if every_tick else 1) * steps
        rows = steps // world.configuration.record_every + 1
        each_step = 2 * self.birds + self.recorders
        each_row = (2 * self.birds + 2) * self.recorders
        return self.links * exchanges + each_step * steps + each_row * rows


def most_epochs(world: World) -> int:
    """Return how many epochs may begin from now on.

    One for each incarnation and each later epoch that the clock has yet to learn of, in a process
    or in a message in flight, and one for a flock that stands still; more after forged messages.
    """
    if world.over:
        return 0
    keeper = world.keeper
    known = keeper._nodes._incarnations
    queues = world.wires.queues
    told = [
        Progress.decode(data)
        for queue in queues
        if queue.topic == topics.PROGRESS_TOPIC
        for data in queue.messages
    ]
    granted = [
        Grant.decode(data).epoch
        for queue in queues
        if queue.topic == topics.GRANT_TOPIC
        for data in queue.messages
    ]
    nodes = [process for process in world.processes if process.core is not keeper]
    lives = {(progress.who, progress.life) for progress in told if progress.who in known}
    lives |= {(process.who, process.core._session.incarnation) for process in nodes}
    unheard = sum(life not in known[who] for who, life in lives)
    unheard -= sum(not heard for heard in known.values())  # the first one of each begins no epoch
    epochs = {progress.epoch for progress in told} | set(granted)
    epochs |= {process.core._session.epoch for process in nodes}
    if world.disk.last_grant:
        epochs.add(world.disk.last_grant.epoch)
    others = len(epochs - {NEVER, keeper.epoch})
    return unheard + others + world.forged_effects + int(world.may_stand_still)


def _most_lost(world: World) -> int:
    """Return how many steps of an epoch that ends early are flown again at most.

    The clock lets the flock fly no further ahead of the disk; or without a recorder, of a bird that
    it does not know. A twin or a forged message may begin an epoch at any step.
    """
    if world.record:
        return topics.steps_ahead(world.configuration, world.stages)
    return world.configuration.steps if world.twins or world.forged else world.window
