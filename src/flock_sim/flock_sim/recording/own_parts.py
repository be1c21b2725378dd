# SPDX-License-Identifier: Apache-2.0
"""The parts of a flight that are not in Flock: laws, link models and birds of the user's own.

A bag contains their names only, and the digests of laws, so a flight with such parts is not
determined by its bag.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.forcing.registry import BUILT_IN as FORCING
from flock_sim.forcing.registry import digests_of
from flock_sim.links.registry import BUILT_IN, MODELS, note_recorded
from flock_sim.links.settings import parted

if TYPE_CHECKING:
    from flock_sim.bag.writing.writer import BagWriter

LAW, LINK_MODEL, BIRD = "law", "link model", "bird"
"""The kinds of own parts."""

_RECORDS = {LAW: "own_law_{}", LINK_MODEL: "own_link_model_{}", BIRD: "own_bird_{}"}
"""The metadata records of the first, second, ... part of each kind."""

_NOTE = "This part was flown, but Flock does not contain it, and this bag has only its name."


@dataclass(frozen=True)
class OwnPart:
    """A law, a link model, or the class of birds or of their protocol, by its name."""

    kind: str
    name: str
    digest: str = field(default="", compare=False)
    """The digest of the source of a law or link model; "" if it is not known."""
    every_stage: bool | None = field(default=None, compare=False)
    """Whether a link model needs the messages of all stages; None if it is not known."""

    def __str__(self) -> str:
        return f"{self.kind} {self.name}"


def own_laws(configuration: FlockConfiguration) -> list[OwnPart]:
    """Return the laws in `configuration` that are not Flock's; their digests if they are loaded."""
    names = [name for name in configuration.forcing_table.names if name not in FORCING]
    digests = digests_of(names)
    return [OwnPart(LAW, name, digests.get(name, "")) for name in names]


def own_link_models(configuration: FlockConfiguration) -> list[OwnPart]:
    """Return the link models in `configuration` that this process has registered."""
    own = {model.name: model for model in MODELS[BUILT_IN:] if not model.recorded}
    named = dict.fromkeys(parted(entry)[1] for entry in configuration.links)
    found = [own[name] for name in named if name in own]
    return [OwnPart(LINK_MODEL, one.name, one.digest, one.every_stage) for one in found]


def unknown_link_models(links: Iterable[str]) -> list[str]:
    """Return the names of the link models in `links` that this process does not have."""
    known = {model.name for model in MODELS if not model.recorded}
    return [
        name for name in dict.fromkeys(parted(entry)[1] for entry in links) if name not in known
    ]


def own_records(configuration: FlockConfiguration) -> dict[str, dict[str, str]]:
    """Return the metadata records of the laws and link models of a flight that are loaded here."""
    laws = [part for part in own_laws(configuration) if part.name in digests_of([part.name])]
    return _records(laws, 1) | _records(own_link_models(configuration), 1)


def add_parts(bag: BagWriter, parts: Iterable[OwnPart]) -> None:
    """Write the records of those `parts` that `bag` lacks. Those of `own_records` are in its head.

    Raises RunFailed on a full disk.
    """
    known = recorded_parts(bag.metadata)
    new = [part for part in dict.fromkeys(parts) if part not in known]
    for kind in _RECORDS:
        first = 1 + sum(part.kind == kind for part in known)
        for name, record in _records([part for part in new if part.kind == kind], first).items():
            bag.add_metadata(name, record)


def is_here(part: OwnPart) -> bool:
    """Whether this process has a law or link model as it was flown, so that it can be flown."""
    if part.kind == LAW:
        return digests_of([part.name]).get(part.name) == part.digest
    known = [model.name for model in MODELS if not model.recorded]
    return part.kind == LINK_MODEL and part.name in known


def recorded_parts(records: Mapping[str, Mapping[str, str]]) -> list[OwnPart]:
    """Return the own parts in the metadata records of a bag."""
    found: list[OwnPart] = []
    for kind, name in _RECORDS.items():
        number = 1
        while (record := records.get(name.format(number))) is not None:
            stages = record.get("every_stage")
            told = None if stages is None else stages == "true"
            found.append(OwnPart(kind, record.get("name", "?"), record.get("digest", ""), told))
            number += 1
    return found


def _records(parts: Sequence[OwnPart], first: int) -> dict[str, dict[str, str]]:
    """Return the metadata records of `parts` of one kind, numbered from `first`."""
    return {
        _RECORDS[part.kind].format(number): {
            "name": part.name,
            **({"digest": part.digest} if part.digest else {}),
            **({} if part.every_stage is None else {"every_stage": _text(part.every_stage)}),
            "note": _NOTE,
        }
        for number, part in enumerate(parts, first)
    }


def _text(yes: bool) -> str:
    return "true" if yes else "false"


def digests(parts: Iterable[OwnPart], kind: str) -> dict[str, str]:
    """Return the digest of each part of a kind, by its name."""
    return {part.name: part.digest for part in parts if part.kind == kind}


def note_link_models(parts: Iterable[OwnPart]) -> None:
    """Note the recorded link models, so that the configuration of their flight can be read."""
    for part in parts:
        if part.kind == LINK_MODEL and part.every_stage is not None:
            note_recorded(part.name, part.every_stage)


def names(parts: Sequence[OwnPart], kind: str) -> str:
    """Return the names of the parts of a kind, as text; empty without such parts."""
    return ", ".join(part.name for part in parts if part.kind == kind)


def lacking(parts: Sequence[OwnPart]) -> str:
    """Return one line on what the bag of a flight with these parts lacks; empty without parts."""
    if not parts:
        return ""
    listed = ", ".join(map(str, parts))
    return f"flown with {listed}: not a part of Flock, and the bag does not contain it"
