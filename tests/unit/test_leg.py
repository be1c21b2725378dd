# SPDX-License-Identifier: Apache-2.0
"""A bird that embarks on legs, and lands from them, says what one says that never does."""

from __future__ import annotations

from collections import deque
from random import Random

import numpy as np
import pytest

from flock_sim.core.bird_step import feel_and_move
from flock_sim.core.configuration import FlockConfiguration
from flock_sim.core.leg import END, FOREIGN, Leg
from flock_sim.core.messages import Checkpoint, Grant, Wing
from flock_sim.core.protocol import BirdProtocol, Channel, Outgoing
from flock_sim.core.runge_kutta import STAGES
from flock_sim.core.stage_message import HEADER, HEADER_AT, stage_bytes

RUN = 2**64 - 3  # does not fit into a word with a sign
EPOCH = 2**31 + 1
STEPS = 30
FLOCK = FlockConfiguration(
    birds=3,
    t_max=float(STEPS),
    record_every=7,
    span_ratios=("2=0.98,1.01",),
    perturbations=("2@9=0.1,-0.02", "2@14=0,0.01"),
)


class Flown:
    """Bird 2 of three, hearing what birds 1 and 3 say in a flight; `legs`: also by legs."""

    def __init__(self, legs: bool) -> None:
        self.bird = BirdProtocol(2, FLOCK, RUN)
        self.arrays = (
            *(self.bird._own, self.bird._around.geometry, self.bird._inbox.heard),
            *(self.bird._mine, self.bird._work),
        )
        self.leg = self.bird.leg() if legs else None
        self.on_leg = False
        self.by_leg = 0
        self.said: list[Outgoing] = []

    def hear(self, data: bytes) -> None:
        """Take a message: by a leg, if there is one, and land where it is over."""
        if self.leg is None or not (self.on_leg or self.bird.embark(self.leg)):
            self.said += self.bird.receive_stage(data)
            return
        self.on_leg = True
        self.by_leg += 1
        fly(self.leg, self.arrays, data, self.said)
        if self.leg.over:
            self.land()

    def land(self) -> None:
        """Land, if it is on a leg."""
        if self.leg is not None and self.on_leg:
            self.on_leg = False
            self.said += self.bird.land(self.leg)


def fly(leg: Leg, arrays: tuple, data: bytes, said: list[Outgoing]) -> None:
    """Do with one message what the exchange does, in Python."""
    own, geometry, heard, mine, work = arrays
    run_id, step, epoch, other, stage, _ = HEADER.unpack_from(data, HEADER_AT)
    tick = STAGES * step + stage
    assert (run_id, epoch) == (RUN, EPOCH)
    assert tick in (leg.tick, leg.tick + 1)
    lacking = [list(side) for side in leg.lacking]
    lacking[tick & 1].remove(other)
    row = (1, 3).index(other)
    stage_bytes(heard[tick & 1, row], FLOCK.members)[:] = data
    now, end = leg.tick, int(leg.words[END])
    while now < end and not lacking[now & 1]:
        feel_and_move(now, FLOCK.dt, own, geometry, heard, mine, work)
        lacking[now & 1] = [1, 3]
        now += 1
        if now < end:
            out = stage_bytes(mine[now & 1], FLOCK.members)
            HEADER.pack_into(out, HEADER_AT, RUN, now // STAGES, EPOCH, 2, now % STAGES, 2)
            said.append((Channel.STAGE, bytes(out)))
    leg.begin(now, end, RUN, EPOCH, (lacking[0], lacking[1]))


def begun(legs: bool) -> Flown:
    flown = Flown(legs)
    bird = flown.bird
    flown.said += bird.receive_grant(Grant(RUN, 0, STEPS, 1.0, EPOCH))
    for other in (1, 3):
        flown.said += bird.receive_wing(Wing(RUN, other, FLOCK.span_ratio[other - 1]))
    flown.said += bird.receive_checkpoint(Checkpoint.of_start(RUN, EPOCH))
    flown.said += bird.receive_grant(Grant(RUN, STEPS, STEPS, 1.0, EPOCH))
    return flown


def stages_of(other: int) -> list[bytes]:
    """Return stage messages of a neighbour: any numbers do."""
    numbers = np.random.default_rng(other)
    messages = []
    for tick in range(STAGES * STEPS + 1):
        words = numbers.uniform(0.9, 1.1, (1, 5 + 3 * 2 + 2))
        data = stage_bytes(words[0], 2)
        HEADER.pack_into(data, HEADER_AT, RUN, tick // STAGES, EPOCH, other, tick % STAGES, 2)
        messages.append(bytes(data))
    return messages


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("often", [1.0, 0.3], ids=["after each message", "now and then"])
def test_what_is_said_is_the_same_with_legs_wherever_it_lands(often: float, seed: int) -> None:
    random = Random(seed)
    plain, by_legs = begun(legs=False), begun(legs=True)
    waiting = {other: deque(stages_of(other)) for other in (1, 3)}
    while any(waiting.values()):
        # Neighbours are at most one stage ahead of each other.
        longest = max(map(len, waiting.values()))
        other = random.choice([o for o, left in waiting.items() if len(left) == longest])
        data = waiting[other].popleft()
        for flown in (plain, by_legs):
            flown.hear(data)
        if random.random() < often:
            by_legs.land()
            assert by_legs.bird.report() == plain.bird.report()
            assert by_legs.bird.waiting_for == plain.bird.waiting_for
    assert by_legs.said == plain.said
    assert plain.bird.step == STEPS
    assert by_legs.by_leg > STAGES * STEPS  # most messages came on a leg


def test_a_leg_ends_where_there_is_more_to_do_than_to_exchange() -> None:
    flown = begun(legs=True)
    ends = set()
    for data in (message for pair in zip(*map(stages_of, (1, 3)), strict=True) for message in pair):
        if flown.leg is not None and flown.bird.embark(flown.leg):
            ends.add(int(flown.leg.words[END]) // STAGES)
            flown.bird.land(flown.leg)
        flown.said += flown.bird.receive_stage(data)
    # Every seventh is recorded; at half of what is granted leave is asked for; pushes; the end.
    assert ends == {7, 14, 21, 28, STEPS // 2, 9, STEPS}


def embarked() -> tuple[BirdProtocol, Leg]:
    """Return a bird that has passed the first stage, and the leg that it is on."""
    flown = begun(legs=True)
    for data in (stages_of(1)[0], stages_of(3)[0]):
        flown.bird.receive_stage(data)
    assert flown.leg is not None
    assert flown.bird.embark(flown.leg)
    return flown.bird, flown.leg


def test_messages_of_others_are_counted_when_it_lands() -> None:
    bird, leg = embarked()
    leg.words[FOREIGN] = 3
    assert bird.land(leg) == []
    assert bird.ignored_for == {"of another run": 3}


def test_who_is_released_needs_no_legs() -> None:
    bird, leg = embarked()
    bird.land(leg)
    bird.receive_grant(Grant(RUN, STEPS + 1, STEPS, 1.0, EPOCH))
    assert not bird.embark(leg)
    assert bird.finished


def test_birds_that_do_more_at_a_stage_have_no_legs() -> None:
    linked = FlockConfiguration(birds=3, links=("hold:interval=3",))
    assert BirdProtocol(2, linked).leg() is None
    timed = BirdProtocol(2, FLOCK, stage_kernel=lambda *arguments: feel_and_move(*arguments))
    assert timed.leg() is None
    steered = BirdProtocol(2, FLOCK, control=lambda view: np.zeros(2))
    assert steered.leg() is None
