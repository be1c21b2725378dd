# SPDX-License-Identifier: Apache-2.0
"""Members of a sweep: each a flock of its own, and how those that are alike fly as one."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from flock_sim.core.configuration import EXAMPLES, FlockConfiguration
from flock_sim.core.links import settings
from flock_sim.core.links.registry import MODELS
from flock_sim.errors import FlockError

MOST_RECORDS = 20
"""Recorded rows of a flight, after the start: what is lost by a kill is a part of a flight, and
bags stay small."""


@dataclass(frozen=True)
class Link:
    """An entry of the key `links`, taken apart."""

    birds: str
    """SOURCE->TARGET, or nothing where all links are meant."""
    model: str
    values: Mapping[str, str]

    @classmethod
    def read(cls, entry: str) -> Link:
        """Return the parts of an entry that `links` has been found to hold."""
        birds, _, what = entry.partition("=")
        if "->" not in birds or ":" in birds:
            birds, what = "", entry
        model, _, rest = what.partition(":")
        values = dict(item.split("=", 1) for item in rest.split(",")) if rest else {}
        return cls(birds, model, values)

    def having(self, key: str, value: str) -> Link:
        """Return this link with `key`, or its model, set to another value."""
        if key == "model":
            return replace(self, model=value)
        return replace(self, values={**self.values, key: value})

    def __str__(self) -> str:
        values = ",".join(f"{key}={value}" for key, value in self.values.items())
        return (
            (f"{self.birds}=" if self.birds else "") + self.model + (f":{values}" if values else "")
        )


@dataclass(frozen=True)
class Member:
    """One flock: what its configuration file would hold."""

    plain: Mapping[str, Any]
    """The keys that have one value."""
    span_ratios: Mapping[int, str]
    """By bird."""
    links: tuple[Link, ...]
    """First, if any, the one for all links; of each link one at most."""
    pushes: tuple[tuple[int, str], ...]
    """The bird, and the push from the @ on."""

    @classmethod
    def of(cls, configuration: FlockConfiguration) -> Member:
        """Return the flock of a configuration that has one member."""
        links: dict[str, Link] = {}
        for link in map(Link.read, configuration.links):
            links = {**(links if link.birds else {}), link.birds: link}
        parameters = configuration.parameters()
        return cls(
            {key: value for key, value in parameters.items() if key not in EXAMPLES},
            {int(bird): ratio for bird, _, ratio in _parted(configuration.span_ratios)},
            tuple(sorted(links.values(), key=lambda link: link.birds != "")),
            tuple((push.bird, "@" + str(push).partition("@")[2]) for push in configuration.pushes),
        )

    def having_link(self, birds: str, key: str, value: str) -> Member:
        """Return this flock with the `key` of one link, or of all where `birds` is empty, set."""
        links = {link.birds: link for link in self.links}
        general = links.setdefault("", Link("", MODELS[0].name, {}))
        if birds:
            links[birds] = replace(links.get(birds, general), birds=birds).having(key, value)
        else:
            links = {whose: link.having(key, value) for whose, link in links.items()}
        return replace(self, links=tuple(links.values()))

    def configuration(self) -> FlockConfiguration:
        """Return what this member alone would fly. Raises FlockError where it can't be flown."""
        return merged([self])

    @property
    def kind(self) -> object:
        """What members have in common that can fly in the same messages."""
        links = [(k.birds, k.model, k.values.get(settings.INTERVAL), *k.values) for k in self.links]
        return tuple(self.plain.items()), tuple(self.span_ratios), tuple(links)


def merged(members: Sequence[Member]) -> FlockConfiguration:
    """Return the configuration that flies `members`, all of one kind, at once and in this order."""
    first = members[0]
    ratios = {}
    for bird in sorted({1, *first.span_ratios}):  # somebody has to say how many members there are
        ratios[bird] = ",".join(member.span_ratios.get(bird, "1") for member in members)
    links = []
    for k, link in enumerate(first.links):
        given = {key: [member.links[k].values[key] for member in members] for key in link.values}
        texts = {key: _once_or_all(values) for key, values in given.items()}
        links.append(str(replace(link, values=texts)))
    return FlockConfiguration.from_parameters(
        {
            **first.plain,
            "span_ratios": [f"{bird}={values}" for bird, values in ratios.items()],
            "links": links,
            "perturbations": list(_pushes(members)),
        }
    )


def kinds(members: Sequence[Member]) -> list[list[int]]:
    """Return which members, counted from 0, can fly at once, in the order in which they come."""
    found: dict[object, list[int]] = {}
    for number, member in enumerate(members):
        found.setdefault(member.kind, []).append(number)
    return list(found.values())


def record_every(steps: int) -> int:
    """Return the steps between at most MOST_RECORDS recorded rows, the last of them the end's."""
    return next(steps // rows for rows in range(MOST_RECORDS, 0, -1) if steps % rows == 0)


def check_end_recorded(configuration: FlockConfiguration) -> None:
    """Refuse a flight whose last step is not recorded: it is what a sweep tells of."""
    if configuration.steps % configuration.record_every:
        raise FlockError(
            f"record_every = {configuration.record_every}: must divide the {configuration.steps} "
            "steps of the flight, so that its end is recorded; or leave it out"
        )


def _pushes(members: Sequence[Member]) -> Iterator[str]:
    """Yield the pushes of all members, in the order of each: once where all have the same."""
    for pushes in zip(*(member.pushes for member in members), strict=True):
        if len(set(pushes)) == 1:
            bird, rest = pushes[0]
            yield f"{bird}{rest}"
        else:
            yield from (f"{bird}:{m}{rest}" for m, (bird, rest) in enumerate(pushes, start=1))


def _once_or_all(values: Sequence[str]) -> str:
    return values[0] if len(set(values)) == 1 else settings.SEPARATOR.join(values)


def _parted(entries: Sequence[str]) -> Iterator[tuple[str, str, str]]:
    return (entry.partition("=") for entry in entries)
