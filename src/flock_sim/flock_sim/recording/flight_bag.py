# SPDX-License-Identifier: Apache-2.0
"""Requirements on the bag of a flight: its topics, and messages that fit its configuration."""

from __future__ import annotations

from pathlib import Path

from flock_sim.bag.reading.reader import BagReader
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.errors import FlockError
from flock_sim.messages import topics
from flock_sim.messages import types as messages
from flock_sim.messages.handshake import check_handshake


def check_grants(bag: BagReader, configuration: FlockConfiguration, factor: float = 0.0) -> None:
    """Raise FlockError if the flight's clock granted steps of another configuration.

    No CRC covers the configuration in a bag that was cut short. Messages in damaged chunks are
    skipped.
    """
    for topic, _, data in bag.salvage([]):
        if topic == topics.GRANT_TOPIC:
            try:
                check_handshake("the bag", configuration, messages.Grant.decode(data).terms, factor)
            except ValueError:
                continue
            except FlockError as error:
                raise FlockError(
                    f"{bag.path} is damaged: its configuration is not what was flown ({error})"
                ) from error
            return


def check_topics(bag: BagReader, configuration: FlockConfiguration) -> None:
    """Raise FlockError if `bag` does not have the topics of a flight, in their order.

    No CRC covers the topics in a bag that was cut short, and chunks contain only their numbers.
    """
    flown, stages = is_flight(bag), has_stages(bag)
    live = messages.Push.TYPE in bag.types
    free = messages.Ages.TYPE in bag.types
    expected = list(kinds(configuration, flown, stages, live, free))
    numbers: dict[str, set[int]] = {}
    for stream, channels in bag.streams.items():
        numbers.setdefault(stream.topic, set()).update(channel.id for channel in channels)
    if any(numbers.get(name) != {place} for place, name in enumerate(expected, 1)):
        raise FlockError(
            f"{bag.path} is damaged within its beginning: which bird a message is of can't be told;"
            " take another copy of the bag"
        )


def checked_push(data: bytes, configuration: FlockConfiguration) -> messages.Push:
    """Return a recorded push. Raises FlockError if it can't be read or does not fit the flight."""
    try:
        push = messages.Push.decode(data)
    except ValueError as error:
        raise FlockError(f"a perturbation can't be read: {error}") from error
    push.check(configuration)
    return push


def recorded_push(path: Path, data: bytes, configuration: FlockConfiguration) -> messages.Push:
    """Return a push that is recorded in the bag at `path`; raises FlockError as `checked_push`."""
    try:
        return checked_push(data, configuration)
    except FlockError as error:
        raise FlockError(f"{path}: {error}; leave it out by ./flock repair") from error


def has_stages(bag: BagReader) -> bool:
    """Tell whether a flight was recorded with its Runge-Kutta stages, by the types in the bag.

    Types precede topics, so a bag that ends within its head may have types but no topics.
    """
    return messages.Stage.TYPE in bag.types


def is_flight(bag: BagReader) -> bool:
    """Tell whether nodes flew the flight in `bag`, by the types in it as `has_stages` does."""
    return messages.Grant.TYPE in bag.types


def kinds(
    configuration: FlockConfiguration,
    grants: bool,
    stages: bool,
    live: bool = False,
    free: bool = False,
) -> dict[str, type[messages.Message]]:
    """Return the message type of each topic, in the order of the bag."""
    birds = range(1, configuration.birds + 1)
    found: dict[str, type[messages.Message]] = {topics.CLOCK_TOPIC: messages.Time}
    if grants:
        found[topics.GRANT_TOPIC] = messages.Grant
    if grants or live:
        found[topics.PERTURBATION_TOPIC] = messages.Push
    found |= {topics.wing_topic(bird): messages.Wing for bird in birds}
    found |= {topics.state_topic(bird): messages.State for bird in birds}
    if free:
        found |= {topics.ages_topic(bird): messages.Ages for bird in birds}
    elif grants:  # a flight that can be resumed
        link_table = configuration.link_table
        remember = [bird for bird in birds if link_table.remembers(bird)]
        found |= {topics.memory_topic(bird): messages.Memory for bird in remember}
    if stages:
        found |= {topics.stage_topic(bird): messages.Stage for bird in birds}
    return found
