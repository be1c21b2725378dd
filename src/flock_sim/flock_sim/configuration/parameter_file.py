# SPDX-License-Identifier: Apache-2.0
"""The configuration file: a ROS 2 parameter file, in which each section names its nodes.

The section `/**` is for all nodes. Any other section names one node by its full name, such as
`/flock/clock`, or several nodes: `*` stands for one part of a name, and `**` for any number of
parts.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import yaml

from flock_sim.console.arguments import note
from flock_sim.errors import FlockError, nearest
from flock_sim.outside import yaml_text

SECTION = "/**"
PARAMETERS = "ros__parameters"

DEEPEST = 16
"""Most parts of the name of a node or a parameter."""

_NODES = re.compile(r"(/(\w+|\*\*?))+", re.ASCII)


CALLED = "configuration file"


@dataclass(frozen=True)
class Sections:
    """The unchecked parameters of each section, by the name of the section as it was written."""

    parameters: Mapping[str, Mapping[str, Any]]

    @property
    def common(self) -> Mapping[str, Any]:
        """The parameters of all nodes."""
        return self._in(SECTION)

    @property
    def named(self) -> list[str]:
        """The sections besides the one for all nodes."""
        return [name for name in self.parameters if name != SECTION]

    def of(self, node: str) -> dict[str, Any]:
        """Return the parameters of a node, by its full name: its own section wins over `/**`."""
        return {**self.common, **self.own(node)}

    def own(self, node: str) -> dict[str, Any]:
        """Return the parameters of a node from sections other than `/**`."""
        return {key: value for name in self._of(node) for key, value in self._in(name).items()}

    def origin(self, node: str, key: str) -> str:
        """Return the section other than `/**` that gives a node the parameter `key`, or ""."""
        return next((name for name in reversed(self._of(node)) if key in self._in(name)), "")

    def unmatched(self, nodes: Iterable[str]) -> list[str]:
        """Return the sections that match none of `nodes`."""
        used = {name for node in nodes for name in self._of(node)}
        return [name for name in self.named if name not in used]

    @cached_property
    def _several(self) -> Mapping[str, re.Pattern[str]]:
        """The sections for several nodes, with the pattern that the names of these nodes match."""
        return {name: _pattern(name) for name in self.named if "*" in name}

    def _of(self, node: str) -> list[str]:
        """Return the sections for a node besides `/**`. Its own section is the last one and wins.

        Sections for several nodes are in the order of the file, as in ROS 2.
        """
        return [*(name for name, nodes in self._several.items() if nodes.fullmatch(node)), node]

    def _in(self, name: str) -> Mapping[str, Any]:
        return self.parameters.get(name, {})


def read(path: Path) -> dict[str, Any]:
    """Return the unchecked parameters in `path` for all nodes; a note names skipped sections.

    Raises FlockError if it is no parameter file.
    """
    found = sections(path)
    if found.named:
        note(f"note: {path}: only the section {SECTION} is read; skipped: {', '.join(found.named)}")
    return dict(found.common)


def sections(*paths: Path) -> Sections:
    """Return the sections of the files; later files win. Raises FlockError as `read` does."""
    found: dict[str, dict[str, Any]] = {}
    for path in paths:
        for name, parameters in _sections(path, yaml_text.read(path, CALLED), ""):
            found.setdefault(name, {}).update(parameters)
    return Sections(found)


def _sections(path: Path, found: Any, names: str) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the name and the parameters of section `names`, and of each section below it."""
    if found is None and not names:
        return
    where = f"`{PARAMETERS}:`" if names else f"`{SECTION}:`"
    if not isinstance(found, dict) or (names and not found):
        raise FlockError(f"configuration file {path}: must have a section {where}{_within(names)}")
    for key, value in found.items():
        if key == PARAMETERS and names:
            yield names, _parameters(path, value)
            continue
        name = f"{names}/{str(key).removeprefix('/')}"
        if _misspelled(str(key)) or not (isinstance(value, dict) or name == SECTION):
            known = [PARAMETERS] if names else [SECTION]
            raise FlockError(
                f"configuration file {path}: unknown section {key!r}{_within(names)}: "
                f"{nearest(str(key), known)}"
            )
        if not _NODES.fullmatch(name) or name.count("/") > DEEPEST:
            raise FlockError(
                f"configuration file {path}: section {key!r} names no node: write a full name "
                f"such as /flock/bird_01, or {SECTION} for all nodes"
            )
        yield from _sections(path, value, name)


def _misspelled(key: str) -> bool:
    return key != PARAMETERS and key.replace("_", "").lower() in ("rosparameters", "rosparameter")


def _within(names: str) -> str:
    return f" in {names}" if names else ""


def _parameters(path: Path, found: Any) -> dict[str, Any]:
    """Return parameters by name; the names of nested parameters are joined by dots."""
    if found is None:
        return {}
    if not isinstance(found, dict):
        raise FlockError(f"configuration file {path}: {PARAMETERS} must hold `key: value` lines")
    return dict(_flat(path, found, ""))


def _flat(path: Path, found: Mapping[Any, Any], names: str) -> Iterator[tuple[str, Any]]:
    if names.count(".") > DEEPEST:
        raise FlockError(f"configuration file {path}: parameter {names}...: nested too deep")
    for key, value in found.items():
        if isinstance(value, dict):
            yield from _flat(path, value, f"{names}{key}.")
        else:
            yield f"{names}{key}", value


def _pattern(name: str) -> re.Pattern[str]:
    """Return the pattern that the names of the nodes of a section match."""
    parts = {"/**": r"(/\w+)*", "/*": r"/\w+"}
    return re.compile(re.sub(r"/\*\*?", lambda wild: parts[wild[0]], name), re.ASCII)


def text(parameters: Mapping[str, Any]) -> str:
    """Return the text of a parameter file with `parameters`, without those that are empty lists.

    rcl gives an empty list no type and can't hold it. The meaning is the same without it.
    """
    values = {key: value for key, value in parameters.items() if value != []}
    return str(yaml.safe_dump({SECTION: {PARAMETERS: values}}, sort_keys=False))
