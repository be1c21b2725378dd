# SPDX-License-Identifier: Apache-2.0
"""Members of a sweep: each is a flock of its own. Members of one kind can share a flight."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from flock_sim.configuration import span_ratios
from flock_sim.configuration.flock_configuration import LISTS, FlockConfiguration
from flock_sim.errors import FlockError
from flock_sim.links import settings
from flock_sim.links.keys import INTERVAL, SEPARATOR
from flock_sim.links.registry import MODELS

MOST_RECORDS = 200
"""Largest number of recorded rows after the start of a flight. A kill loses only a part of a
flight, a verdict can be given, and bags stay small."""


@dataclass(frozen=True)
class Link:
    """A parsed entry of the key `links`."""

    birds: str
    """SOURCE->TARGET in its shortest form, or empty for all links."""
    model: str
    values: Mapping[str, str]

    @classmethod
    def read(cls, entry: str) -> Link:
        """Return the parts of a valid entry of `links`."""
        link, model, items = settings.parted(entry)
        birds = f"{link[0]}->{link[1]}" if link else ""
        return cls(birds, model, dict(items))

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
    """One flock: the content of its configuration file."""

    plain: Mapping[str, Any]
    """Keys that have one value."""
    span_ratios: Mapping[int, str]
    """Span ratios by bird."""
    links: tuple[Link, ...]
    """At most one entry per link. An entry for all links is the first."""
    pushes: tuple[tuple[int, str], ...]
    """For each perturbation: the bird, and the text from the @ on."""

    @classmethod
    def of(cls, configuration: FlockConfiguration) -> Member:
        """Return the flock of a configuration that has one member."""
        links: dict[str, Link] = {}
        for link in map(Link.read, configuration.links):
            links = {**(links if link.birds else {}), link.birds: link}
        parameters = configuration.parameters()
        return cls(
            {key: value for key, value in parameters.items() if key not in LISTS},
            dict(map(span_ratios.parted, configuration.span_ratios)),
            tuple(sorted(links.values(), key=lambda link: link.birds != "")),
            tuple((push.bird, "@" + str(push).partition("@")[2]) for push in configuration.pushes),
        )

    def having_link(self, birds: str, key: str, value: str) -> Member:
        """Return this flock with `key` set for one link, or for all links if `birds` is empty."""
        # The entry for all links comes first: after those of single links, it would replace them.
        general = Link("", MODELS[0].name, {})
        links = {"": general} | {link.birds: link for link in self.links}
        general = links[""]
        if birds:
            links[birds] = replace(links.get(birds, general), birds=birds).having(key, value)
        else:
            links = {whose: link.having(key, value) for whose, link in links.items()}
        return replace(self, links=tuple(links.values()))

    def configuration(self) -> FlockConfiguration:
        """Return the configuration of this member alone. Raises FlockError if it can't be flown."""
        return merged([self])

    @property
    def kind(self) -> object:
        """A key that is equal for members that can fly in the same messages."""
        links = [(k.birds, k.model, k.values.get(INTERVAL), *k.values) for k in self.links]
        return tuple(self.plain.items()), tuple(self.span_ratios), tuple(links)


def merged(members: Sequence[Member]) -> FlockConfiguration:
    """Return the configuration that flies `members`, all of one kind, at once and in this order."""
    first = members[0]
    ratios = {}
    for bird in sorted({1, *first.span_ratios}):  # bird 1 always, to set the number of members
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
    """Return groups of members, counted from 0, that can fly at once, in their order."""
    found: dict[object, list[int]] = {}
    for number, member in enumerate(members):
        found.setdefault(member.kind, []).append(number)
    return list(found.values())


def record_every(steps: int, most: int = MOST_RECORDS) -> int:
    """Return the steps between at most `most` recorded rows, the last of them at the end."""
    return next(steps // rows for rows in range(most, 0, -1) if steps % rows == 0)


def check_end_recorded(configuration: FlockConfiguration) -> None:
    """Raise FlockError unless the last step, from which a sweep takes its results, is recorded."""
    if configuration.steps % configuration.record_every:
        raise FlockError(
            f"record_every = {configuration.record_every}: must divide the {configuration.steps} "
            "steps of the flight, so that its end is recorded; or leave it out"
        )


def _pushes(members: Sequence[Member]) -> Iterator[str]:
    """Yield the perturbations of all members in order, once if all members have the same."""
    for pushes in zip(*(member.pushes for member in members), strict=True):
        if len(set(pushes)) == 1:
            bird, rest = pushes[0]
            yield f"{bird}{rest}"
        else:
            yield from (f"{bird}:{m}{rest}" for m, (bird, rest) in enumerate(pushes, start=1))


def _once_or_all(values: Sequence[str]) -> str:
    return values[0] if len(set(values)) == 1 else SEPARATOR.join(values)
