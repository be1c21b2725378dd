# SPDX-License-Identifier: Apache-2.0
"""The topics of a flock, and the depths of their queues."""

from __future__ import annotations

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.errors import FlockError
from flock_sim.physics.runge_kutta import STAGES

NAMESPACE = "/flock"
"""The default namespace of the nodes of a flock. The names below are those of a flock in it, and
those in a bag."""

CLOCK_TOPIC = "/clock"
GRANT_TOPIC = f"{NAMESPACE}/clock/grant"
PROGRESS_TOPIC = f"{NAMESPACE}/progress"
CHECKPOINT_TOPIC = f"{NAMESPACE}/checkpoint"
PERTURBATION_TOPIC = f"{NAMESPACE}/perturbation"
RECORDER = "recorder"

PERTURBATION_DEPTH = 1000
"""Number of pushes requested in flight that are kept for late joiners."""

PROGRESS_DEPTH = 1000
"""Number of reports that a process of birds keeps for a new clock, for all of its birds."""

STAGE_DEPTH = 128
"""Number of stages that a bird keeps for slow subscribers. Neighbours need 2, a recorder more."""

FASTEST = 35_000
"""Approximate maximum rate of a flock, in bird steps per second."""

SHORTEST_FETCH, LONGEST_FETCH = 0.02, 0.25
FETCHES = 130
"""Limits, in s, of the delay before a bird announces a new state, and the number of announcements
that all birds of a large flock make per second."""

STATE_BYTES_AHEAD = 4 * 2**20
"""Room, in bytes, for the states of a flock in transit to the recorder."""


def relative(topic: str) -> str:
    """Return the name of a flock's topic within the namespace of its nodes."""
    return topic.removeprefix(f"{NAMESPACE}/")


def bird_name(bird: int) -> str:
    """Return the node name of bird 1..N: bird_01, ..."""
    return f"bird_{bird:02d}"


def wing_topic(bird: int) -> str:
    """Return the topic on which a bird's wing is latched."""
    return f"{NAMESPACE}/{bird_name(bird)}/wing"


def stage_topic(bird: int) -> str:
    """Return the topic of a bird's stages."""
    return f"{NAMESPACE}/{bird_name(bird)}/stage"


def state_topic(bird: int) -> str:
    """Return the topic of a bird's states."""
    return f"{NAMESPACE}/{bird_name(bird)}/state"


def memory_topic(bird: int) -> str:
    """Return the topic of the memory of a bird, which only some birds have."""
    return f"{NAMESPACE}/{bird_name(bird)}/memory"


def ages_topic(bird: int) -> str:
    """Return the topic of the ages of a bird's data on its neighbours, in a free flight."""
    return f"{NAMESPACE}/{bird_name(bird)}/ages"


def rows_ahead(configuration: FlockConfiguration) -> int:
    """Return the maximum number of recorded steps in transit to the recorder."""
    row = configuration.birds * (128 + 32 * configuration.members)
    row += 8 * configuration.members * int(configuration.link_table.memory_ends[-1])
    return min(512, max(8, STATE_BYTES_AHEAD // row))


def steps_ahead(configuration: FlockConfiguration, record_stages: bool) -> int:
    """Return how many steps the flock may be ahead of the last step on disk: two rows or more.

    Raises FlockError if stages are to be recorded and the queues do not hold those of two rows.
    """
    every = configuration.record_every
    steps = rows_ahead(configuration) * every
    if not record_stages:
        return steps
    room = STAGE_DEPTH // STAGES - 2
    if 2 * every > room:
        raise FlockError(
            f"record_every = {every}: must be {room // 2} or less where stages are recorded"
        )
    return min(steps, room)


MOST_TIMES = 2**16
"""Largest depth of the queue of /clock."""


def clock_depth(configuration: FlockConfiguration, every: int) -> int:
    """Return the depth of the queue of /clock, which has every `every`th step and recorded ones.

    `every` 0 means recorded steps only. Raises FlockError if the depth would be above MOST_TIMES.
    """
    rows = depth(CLOCK_TOPIC, configuration)
    if not every:
        return rows
    between = configuration.record_every // every
    if rows * (1 + between) > MOST_TIMES:
        least = -(-configuration.record_every // (MOST_TIMES // rows - 1))
        raise FlockError(
            f"clock_every = {every}: must be 0, or {least} or more with record_every = "
            f"{configuration.record_every}"
        )
    return rows * (1 + between)


def depth(topic: str, configuration: FlockConfiguration) -> int:
    """Return the depth of the queues of `topic`: more than the messages that can be in transit."""
    kind = topic.rpartition("/")[2]
    if kind in ("state", "memory", "ages", "clock"):
        return 2 * rows_ahead(configuration)
    deep = {"stage": STAGE_DEPTH, "perturbation": PERTURBATION_DEPTH, "progress": PROGRESS_DEPTH}
    return deep.get(kind, 1)


def fetch_period(configuration: FlockConfiguration) -> float:
    """Return the delay, in s, before a bird announces a new state for other processes to fetch.

    0 if the states must be sent at once: with a delay the flock would reach the maximum number of
    states in transit to the recorder, and would wait.
    """
    birds = configuration.birds
    longest = birds * steps_ahead(configuration, False) / (4 * FASTEST)
    period = min(max(birds / FETCHES, SHORTEST_FETCH), LONGEST_FETCH, longest)
    return period if period >= SHORTEST_FETCH else 0.0
