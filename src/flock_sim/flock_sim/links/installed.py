# SPDX-License-Identifier: Apache-2.0
"""Link models of installed packages: entry points of the group `flock.links`.

An entry point names a LinkModel, or a perceive function, which has the name of the entry point. It
is loaded when the user names it in `links`, never for a bag or a message.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from importlib.metadata import entry_points

from flock_sim.errors import FlockError, nearest
from flock_sim.links.models import LinkModel
from flock_sim.links.registry import MODELS, register
from flock_sim.links.settings import parted
from flock_sim.links.source_digest import source_digest

GROUP = "flock.links"


def load(links: Iterable[str]) -> None:
    """Register the installed models in `links` that this process does not have.

    Raises FlockError if a model is not installed, or can't be loaded or compiled.
    """
    for entry in links:
        _, name, _ = parted(entry)
        if name not in [model.name for model in MODELS if not model.recorded]:
            register(_installed(f"link {entry!r}", name))


def place(recorded: Mapping[str, str], given: Iterable[str], where: str) -> list[str]:
    """Register the models of a recorded flight that are among `given`; return their names.

    `recorded` has the digest of each model, by its name; `where` names the bag. Raises FlockError
    if the digest of a model differs.
    """
    used = [name for name in given if name in recorded]
    for name in used:
        model = _installed(where, name)
        if model.digest != recorded[name]:
            raise FlockError(
                f"{where}: it was flown with {name} of digest {recorded[name][:15]}..., and the "
                f"installed one has {model.digest[:15]}...; install the package as it was"
            )
        if name not in [known.name for known in MODELS if not known.recorded]:
            register(model)
    return used


def _installed(called: str, name: str) -> LinkModel:
    points = {point.name: point for point in entry_points(group=GROUP)}
    if name not in points:
        known = [*(model.name for model in MODELS), *points]
        raise FlockError(f"{called}: unknown model {name!r}: {nearest(name, known)}")
    point = points[name]
    try:
        found = point.load()
    except Exception as error:
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        raise FlockError(f"link model {name!r} of {point.value}: {reason}") from error
    model = found if isinstance(found, LinkModel) else LinkModel(name, found)
    if not callable(model.perceive):
        raise FlockError(f"link model {name!r} of {point.value}: must be a LinkModel or a function")
    return replace(model, name=name, digest=source_digest(model.perceive))
