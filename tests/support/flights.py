# SPDX-License-Identifier: Apache-2.0
"""Recorded flights for the tests of their readers."""

from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.launcher.reference_flight import row
from flock_sim.messages import topics
from flock_sim.messages.types import Grant, State, Time, Wing
from flock_sim.physics.flock_state import FlockState
from flock_sim.recording.flight_writer import recording
from flock_sim.recording.row_assembler import Row
from flock_sim.reference.integrator import Reference

Change = Callable[[int, State], State | None]
"""A change of a bird's state before it is written to the bag; None: it is left out."""


def keep(bird: int, state: State) -> State:
    return state


def record(
    directory: Path,
    configuration: FlockConfiguration,
    change: Change = keep,
    *,
    states: Iterable[FlockState] | None = None,
    span_ratio: np.ndarray | None = None,
    run_id: int = 0,
    grants: bool = False,
    bird_by_bird: bool = False,
) -> Path:
    """Record a flight, by default that of the configuration. Return its directory.

    `bird_by_bird` writes all states of bird 1, then all of bird 2, and so on.
    """
    birds = range(1, configuration.birds + 1)
    ratio = configuration.span_ratio if span_ratio is None else span_ratio
    rows = []  # (place in the bag, topic, stamp, data)
    for recorded in Reference(configuration).fly() if states is None else states:
        step = recorded.step
        stamp = configuration.stamp(step)
        if step == 0:
            for bird in birds:
                wing = Wing(run_id, bird, ratio[bird - 1])
                rows.append((-1, topics.wing_topic(bird), stamp, wing.encode()))
        rows.append((step, topics.CLOCK_TOPIC, stamp, Time.at(stamp).encode()))
        if grants:
            grant = Grant(run_id, step, configuration.steps, configuration.dt, 3)
            rows.append((step, topics.GRANT_TOPIC, stamp, grant.encode()))
        for bird, flown in enumerate(State.of_flock(configuration, recorded), 1):
            state = change(bird, flown)
            if state is not None:
                place = bird * (configuration.steps + 1) if bird_by_bird else step
                rows.append((place, topics.state_topic(bird), stamp, state.encode()))
    with recording(directory, configuration, grants=grants) as run:
        for _, topic, stamp, data in sorted(rows, key=lambda row: row[0]):
            run.write(topic, stamp, data)
    return directory


def flown_rows(configuration: FlockConfiguration) -> list[Row]:
    """Return every recorded step of a flight, as `Recording.write_row` takes it."""
    return [row(configuration, recorded) for recorded in Reference(configuration).fly()]
