# SPDX-License-Identifier: Apache-2.0
"""The file of a sweep: the common configuration of all members, and the axes that they vary."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import yaml

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.errors import FlockError, nearest
from flock_sim.messages.state import ARRAYS
from flock_sim.outside import yaml_text
from flock_sim.recording.own_parts import own_laws, own_link_models
from flock_tools.experiments.sweep.axes import Axis, Value, axis, in_order, text
from flock_tools.experiments.sweep.members import (
    Member,
    check_end_recorded,
    kinds,
    merged,
    record_every,
)
from flock_tools.experiments.sweep.size import LANES, MOST_MEMBERS, PART_NUMBERS

CALLED = "sweep file"
FLOCK, AXES = "flock", "axes"


@dataclass(frozen=True)
class Flight:
    """Members that fly at once."""

    number: int
    """Number of the flight, from 1."""
    members: tuple[int, ...]
    """Indices in the sweep, from 0."""
    configuration: FlockConfiguration


@dataclass(frozen=True)
class Part:
    """Some members of a flight, as a flight of their own: members do not affect each other."""

    flight: int
    """Number of the flight, from 1."""
    first: int
    """Number of the first of these members in the flight, from 1."""
    members: tuple[int, ...]
    """Indices in the sweep, from 0."""
    configuration: FlockConfiguration

    @property
    def member_steps(self) -> int:
        """Number of steps of all members."""
        return len(self.members) * self.configuration.steps


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
        return self._members

    @cached_property
    def _members(self) -> list[Member]:
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

    def parts(self, at_once: int) -> list[Part]:
        """Return the flights of at most `at_once` members, divided into parts that fly alone."""
        members = self.members()
        found = []
        for flight in self.flights(at_once):
            flown = flight.configuration
            numbers = len(ARRAYS) * flown.birds * (flown.steps // flown.record_every + 1)
            most = min(LANES, max(1, PART_NUMBERS // numbers))
            for first in range(0, len(flight.members), most):
                share = flight.members[first : first + most]
                alone = merged([members[m] for m in share])
                found.append(Part(flight.number, first + 1, share, alone))
        return found

    def plan(self, at_once: int, reference: bool = False) -> str:
        """Return what determines the content of the directory of this sweep."""
        how: dict[str, Any] = {"members_at_once": at_once}
        if reference:  # there, no bag has the digests of the laws
            own = [*own_laws(self.flock), *own_link_models(self.flock)]
            how |= {"reference": True, "own_parts": [f"{part} {part.digest}" for part in own]}
        return self.text() + yaml.safe_dump(how, sort_keys=False)

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
    found = yaml_text.read(path, CALLED)
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
