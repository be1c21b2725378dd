# SPDX-License-Identifier: Apache-2.0
"""A bird that enters and leaves the fast path sends the same messages as one that does not."""

from __future__ import annotations

from collections import deque
from random import Random

import numpy as np
import pytest

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.messages.stage_layout import HEADER, HEADER_AT, stage_bytes
from flock_sim.messages.types import Checkpoint, Grant, Wing
from flock_sim.physics.runge_kutta import STAGES
from flock_sim.protocol.bird import BirdProtocol, Channel, Outgoing
from flock_sim.protocol.bird_kernel import feel_and_move
from flock_sim.protocol.fast_path import END, FOREIGN, FastPath

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
    """Bird 2 of three, with the messages of birds 1 and 3; `fast`: also on the fast path."""

    def __init__(self, fast: bool) -> None:
        self.bird = BirdProtocol(2, FLOCK, RUN)
        self.arrays = (
            *(self.bird._own, self.bird._around.geometry, self.bird._inbox.heard),
            *(self.bird._mine, self.bird._work),
        )
        self.path = self.bird.fast_path() if fast else None
        self.on_path = False
        self.by_path = 0
        self.said: list[Outgoing] = []

    def hear(self, data: bytes) -> None:
        """Take a message: by a path, if there is one, and land where it is over."""
        if self.path is None or not (self.on_path or self.bird.enter(self.path)):
            self.said += self.bird.receive_stage(data)
            return
        self.on_path = True
        self.by_path += 1
        fly(self.path, self.arrays, data, self.said)
        if self.path.over:
            self.leave()

    def leave(self) -> None:
        """Land, if it is on a path."""
        if self.path is not None and self.on_path:
            self.on_path = False
            self.said += self.bird.leave(self.path)


def fly(path: FastPath, arrays: tuple, data: bytes, said: list[Outgoing]) -> None:
    """Do with one message what the exchange does, in Python."""
    own, geometry, heard, mine, work = arrays
    run_id, step, epoch, other, stage, _ = HEADER.unpack_from(data, HEADER_AT)
    tick = STAGES * step + stage
    assert (run_id, epoch) == (RUN, EPOCH)
    assert tick in (path.tick, path.tick + 1)
    lacking = [list(side) for side in path.lacking]
    lacking[tick & 1].remove(other)
    row = (1, 3).index(other)
    stage_bytes(heard[tick & 1, row], FLOCK.members)[:] = data
    now, end = path.tick, int(path.words[END])
    while now < end and not lacking[now & 1]:
        feel_and_move(now, FLOCK.dt, own, geometry, heard, mine, work)
        lacking[now & 1] = [1, 3]
        now += 1
        if now < end:
            out = stage_bytes(mine[now & 1], FLOCK.members)
            HEADER.pack_into(out, HEADER_AT, RUN, now // STAGES, EPOCH, 2, now % STAGES, 2)
            said.append((Channel.STAGE, bytes(out)))
    path.begin(now, end, RUN, EPOCH, (lacking[0], lacking[1]))


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
def test_the_same_is_said_on_the_fast_path_wherever_it_is_left(often: float, seed: int) -> None:
    random = Random(seed)
    plain, by_fast_path = begun(fast=False), begun(fast=True)
    waiting = {other: deque(stages_of(other)) for other in (1, 3)}
    while any(waiting.values()):
        # Neighbours are at most one stage ahead of each other.
        longest = max(map(len, waiting.values()))
        other = random.choice([o for o, left in waiting.items() if len(left) == longest])
        data = waiting[other].popleft()
        for flown in (plain, by_fast_path):
            flown.hear(data)
        if random.random() < often:
            by_fast_path.leave()
            assert by_fast_path.bird.report() == plain.bird.report()
            assert by_fast_path.bird.waiting_for == plain.bird.waiting_for
    assert by_fast_path.said == plain.said
    assert plain.bird.step == STEPS
    assert by_fast_path.by_path > STAGES * STEPS  # most messages came on the fast path


def test_the_fast_path_ends_where_there_is_more_to_do_than_to_exchange() -> None:
    flown = begun(fast=True)
    ends = set()
    for data in (message for pair in zip(*map(stages_of, (1, 3)), strict=True) for message in pair):
        if flown.path is not None and flown.bird.enter(flown.path):
            ends.add(int(flown.path.words[END]) // STAGES)
            flown.bird.leave(flown.path)
        flown.said += flown.bird.receive_stage(data)
    # Every seventh is recorded; at half of what is granted leave is asked for; pushes; the end.
    assert ends == {7, 14, 21, 28, STEPS // 2, 9, STEPS}


def on_fast_path() -> tuple[BirdProtocol, FastPath]:
    """Return a bird that has passed the first stage, and the fast path that it is on."""
    flown = begun(fast=True)
    for data in (stages_of(1)[0], stages_of(3)[0]):
        flown.bird.receive_stage(data)
    assert flown.path is not None
    assert flown.bird.enter(flown.path)
    return flown.bird, flown.path


def test_messages_of_others_are_counted_when_it_is_left() -> None:
    bird, path = on_fast_path()
    path.words[FOREIGN] = 3
    assert bird.leave(path) == []
    assert bird.ignored_for == {"of another run": 3}


def test_who_is_released_needs_no_fast_path() -> None:
    bird, path = on_fast_path()
    bird.leave(path)
    bird.receive_grant(Grant(RUN, STEPS + 1, STEPS, 1.0, EPOCH))
    assert bird.enter(path), "no message ends a flight early"
    bird.leave(path)
    bird.report()  # nothing has come for a while
    assert not bird.enter(path)
    assert bird.finished


def test_birds_that_do_more_at_a_stage_have_no_legs() -> None:
    linked = FlockConfiguration(birds=3, links=("hold:interval=3",))
    assert BirdProtocol(2, linked).fast_path() is None
    timed = BirdProtocol(2, FLOCK, stage_kernel=lambda *arguments: feel_and_move(*arguments))
    assert timed.fast_path() is None
    steered = BirdProtocol(2, FLOCK, control=lambda view: np.zeros(2))
    assert steered.fast_path() is None
