# SPDX-License-Identifier: Apache-2.0
"""The content of a flight's bag: its records, its topics, and messages that fit the flight."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from flock_sim import __version__
from flock_sim.bag.reading.reader import BagReader
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.errors import FlockError
from flock_sim.messages import topics
from flock_sim.messages import types as messages
from flock_sim.messages.handshake import check_handshake, read_handshake
from flock_sim.outside import json_text
from flock_sim.recording.machine import Machine
from flock_sim.recording.own_parts import LAW, digests, own_records, recorded_parts

CONFIGURATION_RECORD = "flock"
"""The MCAP metadata record that holds the configuration, each value as JSON."""

RESULT_RECORD = "result"
"""The MCAP metadata record at the end of a bag that was closed."""

_DIGEST = "state_digest"  # the key of the digest of all states, in the record of the result

_MACHINE_RECORD = "machine_{}"  # the record of the first, second, ... machine that recorded

_FREE_RECORD, _FACTOR = "free", "real_time_factor"  # the additional record of a free flight


def records(configuration: FlockConfiguration, factor: float) -> dict[str, dict[str, str]]:
    """Return the metadata records of a bag; `factor` is the real-time factor of a free flight.

    The configuration has the version of Flock that flew it. Without entries, its keys `links` and
    `forcing` are left out, so that such bags keep their original form. Laws and link models of the
    user's own have a record each.
    """
    values: dict[str, Any] = {**configuration.parameters(), "flock_version": __version__}
    for key in ("links", "forcing"):
        if not values[key]:
            del values[key]
    found = {CONFIGURATION_RECORD: {key: json.dumps(value) for key, value in values.items()}}
    found |= own_records(configuration)
    return found | ({_FREE_RECORD: {_FACTOR: json.dumps(factor)}} if factor else {})


def result_record(state_digest: str | None) -> dict[str, dict[str, str]]:
    """Return the last metadata records of a bag; no digest: its states are no whole rows."""
    return {RESULT_RECORD: {_DIGEST: state_digest}} if state_digest else {}


def recorded_digest(bag: BagReader) -> str | None:
    """Return the digest of all states that is in a bag; None for a bag without one."""
    return bag.records.get(RESULT_RECORD, {}).get(_DIGEST)


def machine_records(
    machines: Iterable[Machine], known: Mapping[str, Mapping[str, str]]
) -> dict[str, dict[str, str]]:
    """Return the metadata records that a bag needs for `machines`; it has the `known` ones."""
    new = [record for machine in machines if (record := machine.record()) not in known.values()]
    first = len(recorded_machines(known)) + 1
    return {_MACHINE_RECORD.format(number): record for number, record in enumerate(new, first)}


def recorded_machines(records: Mapping[str, Mapping[str, str]]) -> list[Machine]:
    """Return the machines in the metadata records of a bag, in the order of recording."""
    found: list[Machine] = []
    while (record := records.get(_MACHINE_RECORD.format(len(found) + 1))) is not None:
        found.append(Machine.of(record))
    return found


def recorded_configuration(bag: BagReader) -> FlockConfiguration:
    """Return the configuration in a bag. Raises FlockError or ValueError if there is none.

    The bag of a program that keeps messages but no records has it in its grants.
    """
    if CONFIGURATION_RECORD not in bag.records and topics.GRANT_TOPIC in bag.topics:
        return granted_configuration(bag)[0]
    record = bag.metadata(CONFIGURATION_RECORD)
    values = {key: json_text.parse(value) for key, value in record.items()}
    values.pop("flock_version", None)
    return FlockConfiguration.from_parameters(values)


def granted_configuration(bag: BagReader) -> tuple[FlockConfiguration, float]:
    """Return the configuration in the first grant of a bag, and the real-time factor as below.

    Raises FlockError if there is none.
    """
    for _, _, data in bag.messages([topics.GRANT_TOPIC]):
        with suppress(ValueError):
            return read_handshake(messages.Grant.decode(data).terms)
    raise FlockError(f"no message on {topics.GRANT_TOPIC} has a configuration")


def recorded_factor(bag: BagReader) -> float:
    """Return the real-time factor of a free flight; 0 for a flight in lockstep.

    Raises FlockError if it can't be read.
    """
    if topics.ages_topic(1) not in bag.topics:
        return 0.0
    try:
        if CONFIGURATION_RECORD not in bag.records:
            return granted_configuration(bag)[1]
        return float(json_text.parse(bag.metadata(_FREE_RECORD)[_FACTOR]))
    except (KeyError, TypeError, ValueError) as error:
        raise FlockError(
            f"{bag.path}: the real-time factor can't be read ({error}); take another copy of "
            "the bag"
        ) from error


def check_grants(bag: BagReader, configuration: FlockConfiguration, factor: float = 0.0) -> None:
    """Raise FlockError if the flight's clock granted steps of another configuration.

    No CRC covers the configuration in a bag that was cut short. Messages in damaged chunks are
    skipped.
    """
    laws = digests(recorded_parts(bag.records), LAW)
    for topic, _, data in bag.salvage([]):
        if topic == topics.GRANT_TOPIC:
            try:
                terms = messages.Grant.decode(data).terms
                check_handshake("the bag", configuration, terms, factor, laws)
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
            f"{bag.path} is damaged at its beginning, so the bird of a message is unknown;"
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
        raise FlockError(f"{path}: {error}; remove it with ./flock repair") from error


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
