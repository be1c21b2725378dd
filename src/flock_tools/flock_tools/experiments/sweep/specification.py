# SPDX-License-Identifier: Apache-2.0
"""The file of a sweep: the common configuration of all members, and the axes that they vary."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import yaml

from flock_sim.configuration import parameter_file
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.errors import FlockError, nearest
from flock_tools.experiments.sweep.axes import Axis, Value, axis, in_order, text
from flock_tools.experiments.sweep.members import (
    Member,
    check_end_recorded,
    kinds,
    merged,
    record_every,
)

CALLED = "sweep file"
FLOCK, AXES = "flock", "axes"

MOST_MEMBERS = 100_000


@dataclass(frozen=True)
class Flight:
    """Members that fly at once."""

    number: int
    """Number of the flight, from 1."""
    members: tuple[int, ...]
    """Indices in the sweep, from 0."""
    configuration: FlockConfiguration


@dataclass(frozen=True)
class Sweep:
    """A flock, and its axes. Members are the product of the axes; the last axis varies fastest."""

    flock: FlockConfiguration
    """The common configuration of all members."""
    axes: tuple[Axis, ...]
    given_record_every: bool = False
    """Whether the file sets record_every."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of values along each axis."""
        return tuple(len(axis.values) for axis in self.axes)

    @property
    def size(self) -> int:
        """Number of members."""
        return math.prod(self.shape)

    def members(self) -> list[Member]:
        """Return all members. Raises FlockError, which names the member, if one can't be flown."""
        base = Member.of(self.flock)
        return [self._member(base, values) for values in self._points()]

    def flights(self, at_once: int) -> list[Flight]:
        """Return all members, divided into flights of at most `at_once` members."""
        members = self.members()
        shares = [
            kind[first : first + at_once]
            for kind in kinds(members)
            for first in range(0, len(kind), at_once)
        ]
        return [
            Flight(number, tuple(share), merged([members[m] for m in share]))
            for number, share in enumerate(shares, start=1)
        ]

    def text(self) -> str:
        """Return the text of an equivalent file with axes as lists."""
        given = self.flock.parameters()
        if not self.given_record_every:
            del given["record_every"]
        axes = {axis.name: list(axis.values) for axis in self.axes}
        return str(yaml.safe_dump({FLOCK: given, AXES: axes}, sort_keys=False))

    def _points(self) -> Iterator[tuple[Value, ...]]:
        return itertools.product(*(axis.values for axis in self.axes))

    def _member(self, base: Member, values: tuple[Value, ...]) -> Member:
        value_of = dict(zip((axis.name for axis in self.axes), values))
        member = base
        for one in in_order(self.axes):
            member = one.vary(member, value_of[one.name])
        try:
            configuration = member.configuration()
            if self.given_record_every:
                check_end_recorded(configuration)
                return member
        except FlockError as error:
            where = ", ".join(f"{name} = {text(value)}" for name, value in value_of.items())
            raise FlockError(f"{error} (at {where})") from None
        every = record_every(configuration.steps)
        return replace(member, plain={**member.plain, "record_every": every})


def read(path: Path) -> Sweep:
    """Return the sweep in a file. Raises FlockError if the file is invalid."""
    found = parameter_file.content(path, CALLED)
    try:
        return sweep(found)
    except FlockError as error:
        raise FlockError(f"{CALLED} {path}: {error}") from error


def sweep(found: Any) -> Sweep:
    """Return the sweep of a file with this content. Raises FlockError, which names the remedy."""
    if not isinstance(found, Mapping):
        raise FlockError(f"must have a section `{AXES}:`, and may have `{FLOCK}:`")
    for key in found:
        if key not in (FLOCK, AXES):
            raise FlockError(f"unknown section {key!r}: {nearest(str(key), (FLOCK, AXES))}")
    given, axes = found.get(FLOCK) or {}, found.get(AXES)
    if not isinstance(given, Mapping):
        raise FlockError(f"`{FLOCK}:` must hold `key: value` lines, as a configuration file")
    if not isinstance(axes, Mapping) or not axes:
        raise FlockError(f"`{AXES}:` must hold one or more lines such as `span_ratio[2]: [0.9, 1]`")
    flock = FlockConfiguration.given({str(key): value for key, value in given.items()})
    if flock.members > 1:
        raise FlockError(
            f"`{FLOCK}:` gives values for {flock.members} members: give one value of each here, "
            f"and those that differ below `{AXES}:`"
        )
    wanted = tuple(axis(str(name), values) for name, values in axes.items())
    _check_apart(wanted)
    asked = Sweep(flock, wanted, "record_every" in given)
    if asked.size > MOST_MEMBERS:
        raise FlockError(
            f"{' x '.join(map(str, asked.shape))} values are {asked.size} members: must be "
            f"{MOST_MEMBERS} or less"
        )
    return asked


def _check_apart(axes: tuple[Axis, ...]) -> None:
    """Raise FlockError if two axes name the same parameter."""
    names: dict[str, str] = {}
    for one in axes:
        if one.dimension in names:
            raise FlockError(
                f"axis {one.name!r}: is the same as {names[one.dimension]!r}; leave one out"
            )
        names[one.dimension] = one.name
