# SPDX-License-Identifier: Apache-2.0
"""The configuration file: a ROS 2 parameter file with one section, `/**`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from flock_sim.core.spelling import nearest
from flock_sim.errors import FlockError

SECTION = "/**"
PARAMETERS = "ros__parameters"


class _Loader(yaml.SafeLoader):
    """A safe loader that does not let the last of two equal keys win."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        keys = [self.construct_object(key, deep=deep) for key, _ in node.value]
        for key in keys:
            if keys.count(key) > 1:
                mark = node.start_mark
                raise yaml.constructor.ConstructorError(None, None, f"{key!r} is given twice", mark)
        return super().construct_mapping(node, deep)


def content(path: Path, called: str) -> Any:
    """Return what the YAML file `path` holds; `called` says in complaints what file it is.

    Raises FlockError if it can't be read, is not YAML, or gives a key twice.
    """
    try:
        return yaml.load(path.read_text(encoding="utf-8"), _Loader)
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "it is not UTF-8 text"
        raise FlockError(f"{called} {path}: {reason}; name a readable {called}") from error
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        place = f" at line {mark.line + 1}, column {mark.column + 1}" if mark else ""
        problem = getattr(error, "problem", None) or "cannot be read"
        raise FlockError(f"{called} {path}: not YAML{place} ({problem})") from error


def read(path: Path) -> dict[str, Any]:
    """Return the parameters in `path`, unchecked. Raises FlockError if it is no parameter file."""
    found = content(path, "configuration file")
    if found is None:
        return {}
    section = _only(path, found, SECTION)
    parameters = _only(path, section, PARAMETERS)
    if parameters is None:
        return {}
    if not isinstance(parameters, dict):
        raise FlockError(f"configuration file {path}: {PARAMETERS} must hold `key: value` lines")
    return {str(key): value for key, value in parameters.items()}


def text(parameters: Mapping[str, Any]) -> str:
    """Return the text of a parameter file with `parameters`, but for empty lists.

    rcl gives an empty list no type, and so no place; leaving it out says the same.
    """
    values = {key: value for key, value in parameters.items() if value != []}
    return str(yaml.safe_dump({SECTION: {PARAMETERS: values}}, sort_keys=False))


def _only(path: Path, found: Any, key: str) -> Any:
    """Return the one entry that `found` must have."""
    if not isinstance(found, dict):
        raise FlockError(f"configuration file {path}: must have a section `{key}:`")
    for other in found:
        if other != key:
            hint = nearest(str(other), [key])
            raise FlockError(f"configuration file {path}: unknown section {other!r}: {hint}")
    return found.get(key)
