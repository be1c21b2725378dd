# SPDX-License-Identifier: Apache-2.0
"""The topics of a flock, and how deep the queues on them are."""

from __future__ import annotations

from flock_sim.core.configuration import FlockConfiguration
from flock_sim.core.runge_kutta import STAGES
from flock_sim.errors import FlockError

NAMESPACE = "/flock"
CLOCK_TOPIC = "/clock"
GRANT_TOPIC = f"{NAMESPACE}/clock/grant"
PROGRESS_TOPIC = f"{NAMESPACE}/progress"
CHECKPOINT_TOPIC = f"{NAMESPACE}/checkpoint"
PERTURBATION_TOPIC = f"{NAMESPACE}/perturbation"
RECORDER = "recorder"

PERTURBATION_DEPTH = 1000
"""Pushes asked for in flight that are kept for who comes late."""

STAGE_DEPTH = 128
"""Stages that a bird keeps for a listener that is slow; neighbours need two, a recorder more."""

STATE_BYTES_AHEAD = 4 * 2**20
"""Room for the states of a flock on their way to the recorder."""


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
    """Return the topic of what a bird remembers, if it remembers anything."""
    return f"{NAMESPACE}/{bird_name(bird)}/memory"


def ages_topic(bird: int) -> str:
    """Return the topic of how old what a bird knows is, in a free flight."""
    return f"{NAMESPACE}/{bird_name(bird)}/ages"


def rows_ahead(configuration: FlockConfiguration) -> int:
    """Return how many recorded steps may be on their way to the recorder at once."""
    row = configuration.birds * (128 + 32 * configuration.members)
    row += 8 * configuration.members * int(configuration.linkage.memory_ends[-1])
    return min(512, max(8, STATE_BYTES_AHEAD // row))


def steps_ahead(configuration: FlockConfiguration, record_stages: bool) -> int:
    """Return how many steps the flock may be ahead of what is on disk: two rows or more.

    Raises FlockError where stages are to be recorded and the queues do not hold those of two rows.
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


def depth(topic: str, configuration: FlockConfiguration) -> int:
    """Return the depth of the queues of `topic`: all that may be under way on it, and more."""
    kind = topic.rpartition("/")[2]
    if kind in ("state", "memory", "ages", "clock"):
        return 2 * rows_ahead(configuration)
    return {"stage": STAGE_DEPTH, "perturbation": PERTURBATION_DEPTH}.get(kind, 1)
