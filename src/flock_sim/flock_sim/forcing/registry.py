# SPDX-License-Identifier: Apache-2.0
"""All forcing models: those of the package, and the laws of one's own that a process has loaded."""

from __future__ import annotations

from collections.abc import Iterable

from flock_sim.errors import FlockError, nearest
from flock_sim.forcing.models import CONSTANT, GUST, KEEPER, SINE, ForcingModel

BUILT_IN = {model.name: model for model in (CONSTANT, SINE, KEEPER, GUST)}
"""The models of the package, by name."""

_FILE = ".py:"

_OWN: dict[str, ForcingModel] = {}
"""The laws of one's own, by the name by which a configuration has them."""


def is_file_law(name: str) -> bool:
    """Whether a law is named by its file."""
    return _FILE in name


def model_of(name: str) -> ForcingModel | None:
    """Return the model of a name; None if this process has none."""
    return BUILT_IN.get(name) or _OWN.get(name)


def own_laws() -> dict[str, ForcingModel]:
    """Return the laws of one's own that this process has loaded, by name."""
    return dict(_OWN)


def digests_of(names: Iterable[str]) -> dict[str, str]:
    """Return the digest of the source of each loaded law of one's own among `names`."""
    return {name: _OWN[name].digest for name in names if name in _OWN}


def add(model: ForcingModel) -> None:
    """Add a law of one's own in this process, in place of one with the same name.

    Raises FlockError if the name is that of a built-in model.
    """
    if model.name in BUILT_IN:
        raise FlockError(f"forcing model {model.name!r} exists already: give the law another name")
    _OWN[model.name] = model


def unknown(called: str, name: str) -> FlockError:
    """Return the error for a model that this process does not have."""
    if is_file_law(name):
        return FlockError(
            f"{called}: the law {name!r} is not loaded in this process: create the configuration "
            "by FlockConfiguration.given, or call its load_laws"
        )
    return FlockError(f"{called}: unknown model {name!r}: {nearest(name, [*BUILT_IN, *_OWN])}")
