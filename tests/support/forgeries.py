# SPDX-License-Identifier: Apache-2.0
"""Forged messages: well-formed and of a flight's own run, but not sent by a node of it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from random import Random

import numpy as np

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.messages import topics
from flock_sim.messages.stage_layout import HEADER, HEADER_AT
from flock_sim.messages.types import Checkpoint, Grant, Message, Progress, Push
from flock_sim.physics.runge_kutta import STAGES
from flock_sim.protocol.bird import BirdProtocol

Forge = Callable[[Random, Mapping[str, bytes]], Message]
"""A function that makes a message from the last genuine one of each topic."""

FAR = (2, 1000, 2**20, 2**31 - 1, 2**31, 2**32 - 2)
"""Epochs ahead of the present one."""


def forgeries(random: Random, genuine: Mapping[str, bytes]) -> Iterator[tuple[str, str, bytes]]:
    """Yield (name, topic, message) for ever: all kinds in a random order, repeatedly.

    `genuine` holds the last message of each topic, and is read each time.
    """
    while True:
        for name, (topic, forge) in random.sample(sorted(KINDS.items()), k=len(KINDS)):
            yield name, topic, forge(random, genuine).encode()


def _grant(genuine: Mapping[str, bytes]) -> Grant:
    return Grant.decode(genuine[topics.GRANT_TOPIC])


def _progress(genuine: Mapping[str, bytes]) -> Progress:
    return Progress.decode(genuine[topics.PROGRESS_TOPIC])


def _later(random: Random, epoch: int) -> int:
    return (epoch + random.choice(FAR)) % 2**32 or 1


def _grant_of_a_later_epoch(random: Random, genuine: Mapping[str, bytes]) -> Message:
    grant = _grant(genuine)
    return replace(grant, epoch=_later(random, grant.epoch), step=random.choice([0, grant.step]))


def _grant_of_the_last_epoch(random: Random, genuine: Mapping[str, bytes]) -> Message:
    return replace(_grant(genuine), epoch=2**32 - 1)


def _end_in_the_past(random: Random, genuine: Mapping[str, bytes]) -> Message:
    end = random.randint(0, 50)
    return replace(_grant(genuine), end=end, step=random.choice([0, end, end + 1]))


def _release(random: Random, genuine: Mapping[str, bytes]) -> Message:
    grant = _grant(genuine)
    return replace(grant, step=grant.end + 1)


def _all_leave(random: Random, genuine: Mapping[str, bytes]) -> Message:
    grant = _grant(genuine)
    return replace(grant, step=min(grant.step + random.randint(1, 10**6), grant.end))


def _another_flight(random: Random, genuine: Mapping[str, bytes]) -> Message:
    grant = _grant(genuine)
    terms = grant.terms.replace(f'"dt":{grant.dt}', f'"dt":{grant.dt / 2}')
    assert terms != grant.terms
    return replace(grant, terms=terms, epoch=grant.epoch + random.randint(0, 3))


def _checkpoint(random: Random, genuine: Mapping[str, bytes]) -> Message:
    grant = _grant(genuine)
    epoch = random.choice([2**32 - 1, _later(random, grant.epoch)])
    size = random.choice([0, 1, 3])
    return Checkpoint(grant.run_id, 0, epoch, np.ones(size), np.ones(size))


def _push(random: Random, genuine: Mapping[str, bytes]) -> Message:
    grant = _grant(genuine)
    push = Push(grant.run_id, grant.step + 1000, 0.1, 0.0, grant.epoch + 1, 1, 1)
    wrong = random.choice(
        [
            {"bird": 99},
            {"member": 99},
            {"step": 2**63},
            {"step": 0},
            {"position": math.nan},
            {"speed": math.inf},
            {"number": 0},
            {},
        ]
    )
    return replace(push, **wrong)


def _new_life(random: Random, genuine: Mapping[str, bytes]) -> Message:
    return replace(_progress(genuine), life=random.getrandbits(64))


def _progress_of_a_later_epoch(random: Random, genuine: Mapping[str, bytes]) -> Message:
    progress = _progress(genuine)
    return replace(progress, epoch=_later(random, progress.epoch))


def _progress_beyond_leave(random: Random, genuine: Mapping[str, bytes]) -> Message:
    grant = _grant(genuine)
    step = random.choice([grant.step + 10**5, 2**62])
    return Progress(grant.run_id, step, grant.epoch, "bird_02", _progress(genuine).life)


def _progress_of_a_stranger(random: Random, genuine: Mapping[str, bytes]) -> Message:
    return replace(_progress(genuine), who=random.choice(["bird_99", "", "clock", "x" * 1000]))


KINDS: dict[str, tuple[str, Forge]] = {
    "a grant of a later epoch": (topics.GRANT_TOPIC, _grant_of_a_later_epoch),
    "a grant of the last epoch": (topics.GRANT_TOPIC, _grant_of_the_last_epoch),
    "an end in the past": (topics.GRANT_TOPIC, _end_in_the_past),
    "a release": (topics.GRANT_TOPIC, _release),
    "all leave": (topics.GRANT_TOPIC, _all_leave),
    "another flight of this run": (topics.GRANT_TOPIC, _another_flight),
    "a checkpoint": (topics.CHECKPOINT_TOPIC, _checkpoint),
    "a push": (topics.PERTURBATION_TOPIC, _push),
    "a new life": (topics.PROGRESS_TOPIC, _new_life),
    "progress of a later epoch": (topics.PROGRESS_TOPIC, _progress_of_a_later_epoch),
    "progress beyond leave": (topics.PROGRESS_TOPIC, _progress_beyond_leave),
    "progress of a stranger": (topics.PROGRESS_TOPIC, _progress_of_a_stranger),
}


Header = tuple[int, int, int, int, int, int]
"""Run id, step, epoch, bird, stage and members of a stage message."""

ForgeHeader = Callable[[Header, BirdProtocol, FlockConfiguration], Header]
"""A function that changes the header of a genuine message to a bird, so that it is impossible."""


def _two_exchanges_ahead(
    header: Header, to: BirdProtocol, flight: FlockConfiguration, more: int = 0
) -> Header:
    """Further than a neighbour can be: it has to hear the one between from this bird first."""
    after = flight.link_table.exchange_schedule.after
    step, stage = divmod(after(after(to.tick)) + more, STAGES)
    return header[0], step, *header[2:4], stage, header[5]


STAGES_AHEAD: dict[str, ForgeHeader] = {
    "two exchanges ahead": _two_exchanges_ahead,
    "steps ahead": lambda header, to, flight: _two_exchanges_ahead(header, to, flight, 2 * STAGES),
}
"""Forged headers that are impossible only as long as the bird flies at its present tick."""

STAGE_HEADERS: dict[str, ForgeHeader] = {
    "another run": lambda header, to, flight: (header[0] + 1, *header[1:]),
    "no run": lambda header, to, flight: (0, *header[1:]),
    "no run, no epoch": lambda header, to, flight: (0, header[1], 0, *header[3:]),
    "an older epoch": lambda header, to, flight: (*header[:2], header[2] - 1, *header[3:]),
    "its own echo": lambda header, to, flight: (*header[:3], to.bird, *header[4:]),
    "nobody": lambda header, to, flight: (*header[:3], 0, *header[4:]),
    "a stranger": lambda header, to, flight: (*header[:3], flight.birds + 1, *header[4:]),
    "the end of time": lambda header, to, flight: (header[0], 2**64 - 1, *header[2:]),
    "other members": lambda header, to, flight: (*header[:5], header[5] + 1),
    **STAGES_AHEAD,
}
"""All kinds of forged headers, by name."""


def with_header(
    data: bytes, forge: ForgeHeader, to: BirdProtocol, flight: FlockConfiguration
) -> bytes:
    """Return a stage message with a forged header."""
    forged = bytearray(data)
    header = HEADER.unpack_from(data, HEADER_AT)
    HEADER.pack_into(forged, HEADER_AT, *forge(header, to, flight))
    return bytes(forged)
