# SPDX-License-Identifier: Apache-2.0
"""Meaning of a parameter file for each node of a flight. All nodes fly one configuration."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from flock_sim.configuration import parameter_file
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.configuration.operation import DEFAULTS, parted
from flock_sim.configuration.parameter_file import Sections
from flock_sim.console.arguments import note
from flock_sim.errors import FlockError
from flock_sim.messages import topics

CLOCK = "clock"

Parted = tuple[Mapping[str, Any], Mapping[str, Any]]
"""The configuration and the operation of a node, as parameters."""

OBEYED = (
    "window",
    "clock_every",
    "timeout",
    "executor",
    "record",
    "record_stages",
    "output",
    "real_time_factor",
)
"""Operating parameters that `fly` takes from a file; it sets the others itself."""


def full_name(node: str, namespace: str = topics.NAMESPACE) -> str:
    """Return the full name of a node of a flock."""
    return f"{namespace.rstrip('/')}/{node}"


def resolved(
    sections: Sections, node: str, common: Parted, given: Iterable[str] = ()
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the configuration and the operation of the node of this full name.

    `common` holds those of all nodes. The node's own sections override them, except for parameters
    `given` on the command line. Raises FlockError, with the node, on an unknown parameter.
    """
    own = {key: value for key, value in sections.own(node).items() if key not in set(given)}
    try:
        flown, operation = parted(own)
    except FlockError as error:
        raise FlockError(f"{error} (in a section for {node})") from None
    return {**common[0], **flown}, {**common[1], **operation}


def check_same(
    configuration: FlockConfiguration, flown: Mapping[str, Any], node: str, sections: Sections
) -> None:
    """Raise FlockError, with the key, if the node of this full name flies another flock."""
    theirs = FlockConfiguration.given(flown).parameters()
    for key, value in configuration.parameters().items():
        if theirs[key] != value:
            where = sections.origin(node, key)
            fix = f"leave it out of section {where}" if where else "give it in section /**"
            raise FlockError(
                f"{node} has {key} = {theirs[key]!r} and the other nodes have {value!r}, but a "
                f"flock has one configuration: {fix}"
            )


def together(operations: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """Return the operation of a process with several nodes, from that of each node.

    The shortest timeout applies. Raises FlockError if other parameters differ between the nodes.
    """
    told: dict[str, Any] = {}
    for node, operation in operations.items():
        for key, value in operation.items():
            if key == "timeout":
                value = min(value, told.get(key, value))
            elif told.get(key, value) != value:
                raise FlockError(
                    f"{node} has {key} = {value!r} and another node of its process has "
                    f"{told[key]!r}: give both the same value, or separate processes"
                )
            told[key] = value
    return told


@dataclass(frozen=True)
class FlightParameters:
    """The content of a parameter file for a flight that `fly` or a launch file starts."""

    configuration: FlockConfiguration
    operation: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    """The operation of the nodes by name, as far as the file has it."""

    def of(self, nodes: Iterable[str], keys: Sequence[str] = OBEYED) -> dict[str, Any]:
        """Return the operation of one process with `nodes`: the `keys` that the file has."""
        told = {full_name(node): self.operation.get(node, {}) for node in nodes}
        return {key: value for key, value in together(told).items() if key in keys}


def of_flight(
    path: Path, options: Mapping[str, Any], namespace: str = topics.NAMESPACE
) -> FlightParameters:
    """Return the content of the file in `path` for a flight; `options` override it.

    `namespace` is that of the nodes. Raises FlockError if it can't be flown, or if the nodes would
    fly different flocks.
    """
    sections = parameter_file.sections(path)
    common = parted({**sections.common, **options})
    flown, operation = resolved(sections, full_name(CLOCK, namespace), common, options)
    configuration = FlockConfiguration.given(flown)
    nodes = [topics.RECORDER, *map(topics.bird_name, range(1, configuration.birds + 1))]
    found = {CLOCK: operation}
    for node in nodes:
        full = full_name(node, namespace)
        theirs, found[node] = resolved(sections, full, common, options)
        if theirs != flown:
            check_same(configuration, theirs, full, sections)
    unmatched = sections.unmatched(full_name(node, namespace) for node in found)
    if unmatched:
        note(f"note: {path}: no node of this flight matches section {', '.join(unmatched)}")
    aside = {
        key
        for operation in found.values()
        for key, value in operation.items()
        if key not in OBEYED and value != DEFAULTS[key]
    }
    if aside:
        note(f"note: {path}: only nodes that are started by hand use {', '.join(sorted(aside))}")
    return FlightParameters(configuration, found)
