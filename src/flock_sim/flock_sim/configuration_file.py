# SPDX-License-Identifier: Apache-2.0
"""The configuration file: a ROS 2 parameter file with one section, `/**`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from flock_sim.core.configuration import FlockConfiguration, nearest
from flock_sim.errors import FlockError

SECTION = "/**"
PARAMETERS = "ros__parameters"


def read(path: Path) -> dict[str, Any]:
    """Return the parameters in `path`, unchecked. Raises FlockError if it is no parameter file."""
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "it is not UTF-8 text"
        raise FlockError(
            f"configuration file {path}: {reason}; name a readable parameter file"
        ) from error
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        place = f" at line {mark.line + 1}, column {mark.column + 1}" if mark else ""
        problem = getattr(error, "problem", None) or "cannot be read"
        raise FlockError(f"configuration file {path}: not YAML{place} ({problem})") from error
    if content is None:
        return {}
    section = _only(path, content, SECTION)
    parameters = _only(path, section, PARAMETERS)
    if parameters is None:
        return {}
    if not isinstance(parameters, dict):
        raise FlockError(f"configuration file {path}: {PARAMETERS} must hold `key: value` lines")
    return {str(key): value for key, value in parameters.items()}


def text(configuration: FlockConfiguration) -> str:
    """Return `configuration` as the text of a configuration file, every key given."""
    values = configuration.parameters()
    if not values["span_ratios"]:
        del values["span_ratios"]  # rcl gives an empty list no type
    return str(yaml.safe_dump({SECTION: {PARAMETERS: values}}, sort_keys=False))


def _only(path: Path, content: Any, key: str) -> Any:
    """Return the one entry that `content` must have."""
    if not isinstance(content, dict):
        raise FlockError(f"configuration file {path}: must have a section `{key}:`")
    for other in content:
        if other != key:
            hint = nearest(str(other), [key])
            raise FlockError(f"configuration file {path}: unknown section {other!r}: {hint}")
    return content.get(key)
