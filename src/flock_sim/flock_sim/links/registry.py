# SPDX-License-Identifier: Apache-2.0
"""All link models: those of the package, and those that a process registers."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import replace

from flock_sim.errors import FlockError
from flock_sim.links.models import EXACT, HOLD, LINEAR, LinkModel, Perceive, received

MODELS = [
    EXACT,
    HOLD,
    LINEAR,
]

BUILT_IN = len(MODELS)
"""Number of models that every process has; `register` appends others."""

NAME = re.compile(r"[a-z][a-z0-9_]*")


def register(model: LinkModel) -> None:
    """Add `model` in this process, for all flocks that are configured from now on.

    Its `perceive` may be a plain function, which is compiled here. Raises FlockError if it can't be
    compiled, or if the name is taken or invalid.
    """
    called = f"link model {model.name!r}"
    if not NAME.fullmatch(model.name):
        raise FlockError(f"{called}: must be a letter and then a-z, 0-9 or _, such as fading")
    names = [other.name for other in MODELS]
    if model.name in names and not MODELS[names.index(model.name)].recorded:
        raise FlockError(f"{called} exists already: give the new one another name")
    compiled = replace(model, perceive=_compiled(called, model.perceive), recorded=False)
    if model.name in names:
        MODELS[names.index(model.name)] = compiled
    else:
        MODELS.append(compiled)


def note_recorded(name: str, every_stage: bool) -> None:
    """Note the name of a model that a bag was flown with, and that this process does not have."""
    if name not in [model.name for model in MODELS]:
        MODELS.append(LinkModel(name, received, every_stage, recorded=True))


def check_known(models: Iterable[int]) -> None:
    """Raise FlockError if only the name of one of these models, indices in MODELS, is known."""
    for name in dict.fromkeys(MODELS[model].name for model in models if MODELS[model].recorded):
        raise FlockError(
            f"link model {name!r}: only its name is known, from a bag: register it first, in a "
            "Python process that calls the tool (docs/extending.md)"
        )


def _compiled(called: str, function: Perceive) -> Perceive:
    """Compile the perceive function of a model, and try it. Raises FlockError if that fails."""
    # Imported here: a process that only reads the names of models needs no numba.
    from numba.core.errors import NumbaError

    from flock_sim.physics.compile import anew

    compiled = anew(function)
    try:
        known = compiled(0.0, 0.0, 1.0, 0.5, 0.0)
    except (NumbaError, TypeError) as error:
        reason = next((line for line in str(error).splitlines()[1:] if line.strip()), str(error))
        raise FlockError(
            f"{called}: its perceive can't be compiled ({reason.strip()}); take numbers only, see "
            "docs/extending.md"
        ) from error
    if not (isinstance(known, tuple) and list(map(type, known)) == [float, float]):
        raise FlockError(
            f"{called}: its perceive returns {known!r}: must be a position and a circulation"
        )
    return compiled
