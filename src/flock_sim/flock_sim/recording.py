# SPDX-License-Identifier: Apache-2.0
"""A flight's bag: which topics it has, and how a row of the flight becomes messages in it."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from flock_sim import __version__
from flock_sim.bag.topic import Topic
from flock_sim.bag.writer import BagWriter
from flock_sim.core import messages, topics
from flock_sim.core.configuration import FlockConfiguration
from flock_sim.core.ledger import Row
from flock_sim.core.perturbation import Perturbation

CONFIGURATION_RECORD = "flock"
"""The MCAP metadata record that holds the configuration, each value as JSON."""


class Recording:
    """A bag that takes the rows of one flight."""

    def __init__(
        self,
        directory: Path,
        configuration: FlockConfiguration,
        kinds: Mapping[str, type[messages.Message]],
    ) -> None:
        """Begin a bag; `kinds` gives the message of each topic, in the order of the bag."""
        self._configuration = configuration
        self._stamp = 0
        self.saved = -1
        self.checkpoint: list[bytes] = []
        self._last: Row | None = None
        self.live: dict[int, Perturbation] = {}
        """The pushes asked for in flight that are recorded, by number."""
        self.bag = BagWriter(
            directory,
            [
                Topic(
                    name,
                    kind.TYPE,
                    durability="transient_local",
                    depth=topics.depth(name, configuration),
                )
                for name, kind in kinds.items()
            ],
            {CONFIGURATION_RECORD: configuration_record(configuration)},
        )
        self._place = {name: place for place, name in enumerate(kinds)}
        birds = range(1, configuration.birds + 1)
        self._states = [self._place[topics.state_topic(bird)] for bird in birds]

    def write_row(self, row: Row) -> None:
        """Write everything of one recorded step, at its simulated time."""
        write = self.bag.write
        self._stamp = stamp = self._configuration.stamp(row.step)
        for bird, data in enumerate(row.wings, start=1):
            write(topics.wing_topic(bird), stamp, data)
        for bird, data in row.stages:
            write(topics.stage_topic(bird), stamp, data)
        write(topics.CLOCK_TOPIC, stamp, row.time)
        for place, data in zip(self._states, row.states, strict=True):
            write(place, stamp, data)
        self._last = row

    def flush(self):
        self.bag.flush()
        if self._last:
            self.saved, self.checkpoint = self._last.step, self._last.states

    def write_grant(self, data: bytes) -> None:
        """Write a grant, at the simulated time of the row before it."""
        self.bag.write(topics.GRANT_TOPIC, self._stamp, data)

    def write_perturbation(self, push: messages.Push) -> None:
        """Write a push that was asked for in flight, at the simulated time at which it happens."""
        self.live[push.number] = push.perturbation
        stamp = self._configuration.stamp(push.step)
        self.bag.write(topics.PERTURBATION_TOPIC, stamp, push.encode())


@contextmanager
def recording(
    directory: Path,
    configuration: FlockConfiguration,
    *,
    grants: bool,
    stages: bool = False,
    resume: bool = False,
    live: bool = False,
) -> Iterator[Recording]:
    """Give a recording whose bag is closed, and so complete, however the block ends.

    `live`: with perturbations that are asked for in flight, which one with grants has anyway.
    """
    birds = range(1, configuration.birds + 1)
    kinds: dict[str, type[messages.Message]] = {topics.CLOCK_TOPIC: messages.Time}
    if grants:
        kinds[topics.GRANT_TOPIC] = messages.Grant
    if grants or live:
        kinds[topics.PERTURBATION_TOPIC] = messages.Push
    kinds |= {topics.wing_topic(bird): messages.Wing for bird in birds}
    kinds |= {topics.state_topic(bird): messages.State for bird in birds}
    if stages:
        kinds |= {topics.stage_topic(bird): messages.Stage for bird in birds}
    run = Recording(directory, configuration, kinds)
    try:
        yield run
    finally:
        run.bag.close()


def configuration_record(configuration: FlockConfiguration) -> dict[str, str]:
    """Return the configuration as text, key by key, with the version that flew it."""
    values: dict[str, Any] = {**configuration.parameters(), "flock_version": __version__}
    return {key: json.dumps(value) for key, value in values.items()}


def configuration_of(record: Mapping[str, str]) -> FlockConfiguration:
    """Return the configuration in a bag's record. Raises FlockError or ValueError otherwise."""
    values = {key: json.loads(value) for key, value in record.items()}
    values.pop("flock_version", None)
    return FlockConfiguration.from_parameters(values)


def lay_down(directory, configuration, *, grants, stages):
    pass
