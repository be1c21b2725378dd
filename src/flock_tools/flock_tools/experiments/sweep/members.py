# SPDX-License-Identifier: Apache-2.0
"""Members of a sweep: each is a flock of its own. Members of one kind can share a flight."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

from flock_sim.configuration import span_ratios
from flock_sim.configuration.flock_configuration import LISTS, FlockConfiguration
from flock_sim.errors import FlockError
from flock_sim.forcing import settings as forcing_text
from flock_sim.links import settings
from flock_sim.links.keys import INTERVAL
from flock_sim.links.registry import MODELS
from flock_sim.model_text import SEPARATOR

MOST_RECORDS = 200
"""Largest number of recorded rows after the start of a flight. A kill loses only a part of a
flight, a verdict can be given, and bags stay small."""


@dataclass(frozen=True)
class Entry:
    """A parsed entry of the key `links` or `forcing`."""

    birds: str
    """SOURCE->TARGET or BIRD in its shortest form, or empty for all links or birds."""
    model: str
    values: Mapping[str, str]

    def having(self, key: str, value: str) -> Self:
        """Return this entry with `key` set to another value."""
        return replace(self, values={**self.values, key: value})

    @property
    def kind(self) -> tuple[object, ...]:
        """What members that fly in the same messages have in common."""
        return self.birds, self.model, *self.values

    def __str__(self) -> str:
        values = ",".join(f"{key}={value}" for key, value in self.values.items())
        return (
            (f"{self.birds}=" if self.birds else "") + self.model + (f":{values}" if values else "")
        )


@dataclass(frozen=True)
class Force(Entry):
    """A parsed entry of the key `forcing`."""

    @classmethod
    def read(cls, entry: str) -> Force:
        """Return the parts of a valid entry of `forcing`."""
        found = forcing_text.read(entry)
        bird = "" if found.bird is None else str(found.bird)
        return cls(bird, found.name, dict(found.items))

    @property
    def law(self) -> str:
        """The name of its model without its file."""
        return self.model.rpartition(":")[2]


@dataclass(frozen=True)
class Link(Entry):
    """A parsed entry of the key `links`."""

    @classmethod
    def read(cls, entry: str) -> Link:
        """Return the parts of a valid entry of `links`."""
        link, model, items = settings.parted(entry)
        birds = f"{link[0]}->{link[1]}" if link else ""
        return cls(birds, model, dict(items))

    def having(self, key: str, value: str) -> Link:
        """Return this link with `key`, or its model, set to another value."""
        return replace(self, model=value) if key == "model" else super().having(key, value)

    @property
    def kind(self) -> tuple[object, ...]:
        """What members that fly in the same messages have in common: the interval, too."""
        return *super().kind, self.values.get(INTERVAL)


@dataclass(frozen=True)
class Member:
    """One flock: the content of its configuration file."""

    plain: Mapping[str, Any]
    """Keys that have one value."""
    span_ratios: Mapping[int, str]
    """Span ratios by bird."""
    links: tuple[Link, ...]
    """At most one entry per link. An entry for all links is the first."""
    forcing: tuple[Force, ...]
    """In the order of the configuration."""
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
            tuple(map(Force.read, configuration.forcing)),
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

    def having_forcing(self, bird: str, law: str, key: str, value: str) -> Member:
        """Return this flock with `key` set in the entries of a law, for `bird` if not empty."""
        whose = [one.law == law and bird in ("", one.birds) for one in self.forcing]
        if not any(whose):
            of = f" of bird {bird}" if bird else ""
            raise FlockError(f"no entry of `forcing` has the law {law!r}{of}: add one to `flock:`")
        terms = zip(self.forcing, whose, strict=True)
        changed = (one.having(key, value) if varies else one for one, varies in terms)
        return replace(self, forcing=tuple(changed))

    def configuration(self) -> FlockConfiguration:
        """Return the configuration of this member alone. Raises FlockError if it can't be flown."""
        return merged([self])

    @property
    def kind(self) -> object:
        """A key that is equal for members that can fly in the same messages."""
        entries = [one.kind for one in (*self.links, *self.forcing)]
        return tuple(self.plain.items()), tuple(self.span_ratios), tuple(entries)


def merged(members: Sequence[Member]) -> FlockConfiguration:
    """Return the configuration that flies `members`, all of one kind, at once and in this order."""
    first = members[0]
    ratios = {}
    for bird in sorted({1, *first.span_ratios}):  # bird 1 always, to set the number of members
        ratios[bird] = ",".join(member.span_ratios.get(bird, "1") for member in members)
    return FlockConfiguration.given(
        {
            **first.plain,
            "span_ratios": [f"{bird}={values}" for bird, values in ratios.items()],
            "links": _together([member.links for member in members]),
            "forcing": _together([member.forcing for member in members]),
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


def _together(entries: Sequence[Sequence[Entry]]) -> list[str]:
    """Return the text of entries with the values of all members; `entries` are those of each."""
    texts = []
    for alike in zip(*entries, strict=True):
        values = {key: _once_or_all([one.values[key] for one in alike]) for key in alike[0].values}
        texts.append(str(replace(alike[0], values=values)))
    return texts


def _once_or_all(values: Sequence[str]) -> str:
    return values[0] if len(set(values)) == 1 else SEPARATOR.join(values)
