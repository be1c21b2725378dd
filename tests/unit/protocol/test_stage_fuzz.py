# SPDX-License-Identifier: Apache-2.0
"""A bird among many forged stage messages flies on bit for bit, and keeps none of them.

FLOCK_TORTURE=1 sends a million.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from random import Random

import numpy as np
import pytest

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.messages.stage_layout import HEADER_AT, HEADER_END
from flock_sim.messages.types import Checkpoint, Grant, Wing
from flock_sim.protocol.bird import BirdProtocol
from flock_sim.protocol.session import Outgoing
from flock_sim.protocol.stage_inbox import EARLY
from flock_sim.reference.integrator import Reference

RUN = 7
TORTURE = bool(os.environ.get("FLOCK_TORTURE"))
MESSAGES = 1_000_000 if TORTURE else 50_000

CONFIGURATION = FlockConfiguration(
    birds=3, t_max=60.0, record_every=5, span_ratios=("1=0.9,1.0", "2=1.0,1.1")
)
BIRD = 2
FIELDS = {"run_id": (0, "<Q"), "step": (8, "<Q"), "epoch": (16, "<I"), "bird": (20, "<I"),
          "stage": (24, "<B"), "members": (28, "<I")}  # fmt: skip
"""Where the fields of a header are in it."""

Input = tuple[str, object]


@dataclass(frozen=True)
class Flight:
    """All that bird 2 hears in a flight that is sent back twice, and what it answers to each."""

    inputs: list[Input]
    answers: list[list[Outgoing]]


def new_bird(number: int) -> BirdProtocol:
    return BirdProtocol(number, CONFIGURATION, incarnation=number)


def grant_to(step: int, epoch: int) -> Grant:
    return Grant(RUN, step, CONFIGURATION.steps, CONFIGURATION.dt, epoch)


def checkpoint(step: int, epoch: int) -> Checkpoint:
    flock = Reference(CONFIGURATION)
    flock.advance(step)
    return Checkpoint(RUN, step, epoch, flock.position.ravel(), flock.speed.ravel())


def hear(bird: BirdProtocol, what: Input) -> list[Outgoing]:
    kind, message = what
    receive: Callable[..., list[Outgoing]] = getattr(bird, f"receive_{kind}")
    return receive(message)


def flight() -> Flight:
    """Fly epoch 3 from the start to step 30, epoch 4 from 20 to 45, and epoch 6 from 40 on."""
    birds = {number: new_bird(number) for number in (1, 2, 3)}
    inputs: list[Input] = []
    answers: list[list[Outgoing]] = []

    def fly(queue: list[tuple[int, Input]]) -> None:
        while queue:
            to, what = queue.pop(0)
            out = hear(birds[to], what)
            if to == BIRD:
                inputs.append(what)
                answers.append(out)
            for channel, data in out:
                for other in birds:
                    if to in birds[other].neighbours and channel.value == "stage":
                        queue.append((other, ("stage", data)))
                    elif to in birds[other].neighbours and channel.value == "wing":
                        queue.append((other, ("wing", Wing.decode(data))))

    exchange = [(3, Checkpoint.of_start(RUN, 3), 30), (4, checkpoint(20, 4), 45)]
    exchange.append((6, checkpoint(40, 6), CONFIGURATION.steps))
    for epoch, where, leave in exchange:
        for what in [("grant", grant_to(where.step, epoch)), ("checkpoint", where)]:
            fly([(number, what) for number in birds])
        fly([(number, ("grant", grant_to(leave, epoch))) for number in birds])
    assert all(bird.finished for bird in birds.values())
    assert birds[BIRD].ignored == 0
    return Flight(inputs, answers)


def forgeries(genuine: bytes, random: Random, count: int) -> Iterator[bytes]:
    """Messages like a genuine one, and none that is wanted while that one is, or next."""
    run_id, step, epoch, _, stage, members = struct.unpack_from("<QQIIB3xI", genuine, HEADER_AT)
    others = {
        "run_id": [0, run_id - 1, run_id + 1, 2**64 - 1],
        "step": [step + 1, step + 2, 2**64 - 1, *([step - 1] if step else [])],
        "epoch": [0, epoch - 1, epoch + 1, epoch + 9, epoch + 2**24, 2**32 - 1],
        "bird": [0, BIRD, 4, 2**32 - 1],
        "stage": [(stage + 2) % 4, 4, 255],
        "members": [0, members - 1, members + 1, 2**32 - 1],
    }
    names = list(FIELDS)
    for _ in range(count):
        how = random.randrange(8)
        if how < 4:  # one field, or two
            forged = bytearray(genuine)
            for name in random.sample(names, k=1 + how // 3):
                at, layout = FIELDS[name]
                struct.pack_into(layout, forged, HEADER_AT + at, random.choice(others[name]))
            yield bytes(forged)
        elif how < 6:  # one bit of the header; not the lowest two of the stage, the next one's
            bit = random.randrange(8 * (HEADER_END - HEADER_AT))
            if bit not in (8 * 24, 8 * 24 + 1, 8 * 20, 8 * 20 + 1):
                forged = bytearray(genuine)
                forged[HEADER_AT + bit // 8] ^= 1 << bit % 8
                yield bytes(forged)
        elif how == 6:
            yield genuine[: random.randrange(len(genuine))]
        else:
            yield genuine + bytes(random.randrange(1, 64))


def held(bird: BirdProtocol) -> int:
    """How many messages the bird keeps for later."""
    return sum(map(len, bird._inbox._early.values()))


def test_a_million_forgeries_change_no_bit_and_are_counted() -> None:
    calm = flight()
    random = Random(20261124)
    bird = new_bird(BIRD)
    stages = [what[1] for what in calm.inputs if what[0] == "stage"]
    each = MESSAGES // len(stages) + 1
    thrown = kept = 0
    for what, answer in zip(calm.inputs, calm.answers, strict=True):
        if what[0] == "stage":
            before, held_before = bird.ignored, held(bird)
            count = 0
            for forged in forgeries(what[1], random, each):
                assert bird.receive_stage(forged) == []
                count += 1
            # Those of epochs to come may be kept, so many and no more.
            assert bird.ignored - before + held(bird) - held_before == count
            assert held(bird) <= EARLY * len(bird.neighbours)
            thrown += count
            kept = max(kept, held(bird))
        assert hear(bird, what) == answer
    assert thrown > 0.9 * MESSAGES
    assert kept == EARLY * len(bird.neighbours)
    assert set(bird.ignored_for) == {
        "of another run",
        "not from a neighbour",
        "with a wrong length",
        "of an epoch that is over",
        "for a step or stage that is over or too far ahead",
        "that were received before",
    }


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_before_the_start_and_at_it_no_number_is_no_neighbour(value: float) -> None:
    calm = flight()
    first = next(what[1] for what in calm.inputs if what[0] == "stage")
    bird = new_bird(BIRD)
    begun = False
    for what, answer in zip(calm.inputs, calm.answers, strict=True):
        if bird.step == 0 and not begun:
            for at in range(HEADER_END, len(first), 8):
                forged = bytearray(first)
                if (at - HEADER_END) // 8 % 3 < 2:  # a number, not a length
                    struct.pack_into("<d", forged, at, value)
                    before = bird.ignored
                    assert bird.receive_stage(bytes(forged)) == []
                    assert bird.ignored == before + 1
        begun |= what[0] == "stage"
        assert hear(bird, what) == answer
    assert bird.finished
