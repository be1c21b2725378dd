# SPDX-License-Identifier: Apache-2.0
"""The words of a bird: the protocol and the exchange continue where the other one stopped."""

from __future__ import annotations

from collections import deque
from random import Random

import numpy as np
import pytest

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.messages.stage_layout import HEADER, HEADER_AT, stage_bytes
from flock_sim.messages.types import Checkpoint, Grant, Stage, Wing
from flock_sim.physics.runge_kutta import STAGES
from flock_sim.protocol.bird import BirdProtocol
from flock_sim.protocol.bird_kernel import feel_and_move
from flock_sim.protocol.session import Outgoing
from flock_sim.protocol.stage_words import (
    ANY,
    END,
    EVERY,
    FOREIGN,
    LACKING,
    SIDE,
    TAKEN,
    TICK,
    accept,
    say,
    turn,
)

RUN = 2**64 - 3  # does not fit into a word with a sign
EPOCH = 2**31 + 1
STEPS = 30
FLOCK = FlockConfiguration(
    birds=3,
    t_max=float(STEPS),
    record_every=7,
    span_ratios=("2=0.98,1.01",),
    perturbations=("2@9=0.1,-0.02", "2@14=0,0.01"),
    forcing=("gust:std=1e-3,time=3,seed=1/2", "2=keeper:gap=0.5,stiffness=0.01"),
)


class Flown:
    """Bird 2 of three, with the messages of birds 1 and 3; `fast`: as the exchange flies it."""

    def __init__(self, fast: bool) -> None:
        self.bird = BirdProtocol(2, FLOCK, RUN)
        self.fast = fast
        self.by_exchange = 0
        self.said: list[Outgoing] = []

    def hear(self, data: bytes) -> None:
        """Take a message, on the fast path as the compiled exchange does."""
        if not (self.fast and self.bird.on_fast_path):
            self.said += self.bird.receive_stage(data)
            return
        self.by_exchange += 1
        words = self.bird.words
        message = np.frombuffer(data, np.uint8)
        assert accept(words, ANY, message.ctypes.data, len(data)) == TAKEN
        while words[TICK] < words[END] and not words[LACKING + words[SIDE]]:
            own = self.bird._motion
            arrays = own._own, own._interactions, self.bird._inbox.heard, own._mine, own._work
            feel_and_move(words[TICK], FLOCK.dt, words[EVERY], *arrays, own._forcing_words)
            words[TICK] += 1
            turn(words, words[TICK] + 1)
            say(words)
            self.said += self.bird.last_said[-1:]
        if words[TICK] >= words[END]:
            self.said += self.bird.advance()


def begun(fast: bool) -> Flown:
    flown = Flown(fast)
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
def test_the_same_is_said_on_the_fast_path_whenever_the_bird_is_asked(
    often: float, seed: int
) -> None:
    random = Random(seed)
    plain, fast = begun(fast=False), begun(fast=True)
    waiting = {other: deque(stages_of(other)) for other in (1, 3)}
    while any(waiting.values()):
        # Neighbours are at most one stage ahead of each other.
        longest = max(map(len, waiting.values()))
        other = random.choice([o for o, left in waiting.items() if len(left) == longest])
        data = waiting[other].popleft()
        for flown in (plain, fast):
            flown.hear(data)
        if random.random() < often:
            assert fast.bird.report() == plain.bird.report()
            assert fast.bird.waiting_for == plain.bird.waiting_for
    assert fast.said == plain.said
    assert plain.bird.step == STEPS
    assert fast.by_exchange > STAGES * STEPS  # most messages came on the fast path


def test_the_fast_path_ends_where_there_is_more_to_do_than_to_exchange() -> None:
    flown = begun(fast=True)
    ends = set()
    for data in (message for pair in zip(*map(stages_of, (1, 3)), strict=True) for message in pair):
        if flown.bird.on_fast_path:
            ends.add(int(flown.bird.words[END]))
        flown.hear(data)
    # Every seventh is recorded; at half of what is granted leave is asked for; the end.
    events = {STAGES * step for step in (7, 14, 21, 28, STEPS // 2, STEPS)}
    pushes = {STAGES * 9 - 1, STAGES * 14 - 1}  # the stage whose result is changed
    assert ends == events - {STAGES * 14} | pushes


def on_fast_path() -> BirdProtocol:
    """Return a bird that has passed the first stage."""
    flown = begun(fast=True)
    for data in (stages_of(1)[0], stages_of(3)[0]):
        flown.bird.receive_stage(data)
    assert flown.bird.on_fast_path
    return flown.bird


def test_messages_of_other_runs_are_counted() -> None:
    bird = on_fast_path()
    bird.words[FOREIGN] = 3
    for _ in range(2):
        bird.count_foreign()
        assert bird.ignored_for == {"of another run": 3}


def test_a_released_bird_has_no_fast_path() -> None:
    bird = on_fast_path()
    bird.receive_grant(Grant(RUN, STEPS + 1, STEPS, 1.0, EPOCH))
    assert bird.on_fast_path, "no message ends a flight early"
    bird.report()  # nothing has come for a while
    assert not bird.on_fast_path
    assert bird.finished


def test_birds_that_do_more_at_a_stage_have_no_fast_path() -> None:
    linked = FlockConfiguration(birds=3, links=("hold:interval=3",))
    assert not BirdProtocol(2, linked).only_exchanges


def test_no_message_is_taken_before_the_epoch_begins() -> None:
    bird = BirdProtocol(2, FLOCK, RUN)
    bird.receive_grant(Grant(RUN, 0, STEPS, 1.0, EPOCH))
    before = Stage(RUN, 2**64 - 1, EPOCH, 1, 3, *3 * [np.ones(2)])  # a tick before the first
    assert bird.receive_stage(before.encode()) == []
    assert bird.ignored == 1
