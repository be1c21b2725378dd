# SPDX-License-Identifier: Apache-2.0
"""Laws of one's own: functions in a file that the user names, or of an installed package.

A law is named FILE.py:FUNCTION, or by the name of an entry point of the group `flock.forcing`.
Loading runs its file, so only names that the user has given are loaded: never those of a bag or of
a message.
"""

from __future__ import annotations

import inspect
import json
import os
import sys
import traceback
from collections.abc import Callable, Iterable, Mapping
from importlib.metadata import entry_points
from pathlib import Path
from types import ModuleType
from typing import Any

from flock_sim.errors import FlockError, nearest
from flock_sim.forcing.law import Law
from flock_sim.forcing.models import own_model
from flock_sim.forcing.registry import (
    BUILT_IN,
    add,
    digests_of,
    is_file_law,
    model_of,
    own_laws,
)
from flock_sim.links.source_digest import digest_of_source, source_digest
from flock_sim.outside import json_text
from flock_sim.outside.text import read_bytes

GROUP = "flock.forcing"
"""The group of entry points of laws in installed packages."""

PLACES = "FLOCK_LAWS"
"""Environment variable, for child processes: JSON, the file of each law that is not where its name
says."""


def load(names: Iterable[str]) -> None:
    """Load the laws of these names, except built-in models. Raises FlockError if that fails.

    A law whose file has changed since it was loaded is loaded again.
    """
    for name in names:
        if name not in BUILT_IN:
            add(_loaded(name))


def place(recorded: Mapping[str, str], given: Iterable[str], where: str) -> None:
    """Load the laws of a recorded flight from files that the user names.

    `recorded` has the digest of each law, by its name; `given` are files, or names of laws of
    installed packages; `where` names the bag. Raises FlockError if a law is not among them, if its
    digest differs, or if one of `given` is not of use.
    """
    files = {text: _digest(Path(text)) for text in given if text.endswith(".py")}
    installed = [text for text in given if text not in files]
    used = set()
    for name, digest in recorded.items():
        if not is_file_law(name):
            if name not in installed:
                raise FlockError(_not_named(where, name, name))
            load([name])
            found = digests_of([name])[name]
            if found != digest:
                raise FlockError(_changed(where, name, digest, {name: found}))
            used.add(name)
            continue
        path, _, _ = name.rpartition(":")
        fitting = [text for text, found in files.items() if found == digest]
        if not fitting:
            same_name = {t: d for t, d in files.items() if Path(t).name == Path(path).name}
            if same_name:
                raise FlockError(_changed(where, name, digest, same_name))
            raise FlockError(_not_named(where, name, path))
        used.add(fitting[0])
        places = {**_places(), name: str(Path(fitting[0]).absolute())}
        os.environ[PLACES] = json.dumps(places)
        load([name])
    for text in given:
        if text not in used and not any(files.get(text) == files.get(other) for other in used):
            raise FlockError(f"{where}: it was flown without --law {text}; leave it out")


def _not_named(where: str, name: str, law: str) -> str:
    return (
        f"{where}: it was flown with the law {name}, and a bag never loads a law: name it with "
        f"--law {law}"
    )


def _changed(where: str, name: str, digest: str, found: Mapping[str, str]) -> str:
    (text, other), *_ = found.items()
    return (
        f"{where}: it was flown with {name} of digest {digest[:15]}..., and --law {text} has "
        f"{other[:15]}...; name the file as it was"
    )


def _places() -> dict[str, str]:
    try:
        found = json_text.parse(os.environ.get(PLACES, "{}"))
    except ValueError:
        return {}
    return found if isinstance(found, dict) else {}


def _loaded(name: str) -> Any:
    """Return the model of a law of one's own, as it is now on disk."""
    called = f"law {name!r}"
    if is_file_law(name):
        path, _, function = name.rpartition(":")
        file = Path(_places().get(name, path))
        source = read_bytes(file, "law file")
        digest = digest_of_source(source)
        known = model_of(name)
        if known and known.digest == digest:
            return known
        law = _function_in(_run(file, source, digest), function, called, file)
    else:
        law, digest = _installed(name)
    try:
        return own_model(name, law, digest)
    except FlockError as error:
        raise FlockError(f"{called}: {error}") from error


def _digest(file: Path) -> str:
    return digest_of_source(read_bytes(file, "law file"))


def _run(file: Path, source: bytes, digest: str) -> ModuleType:
    """Run a file; return its module. No compiled file is written beside it."""
    module = ModuleType(f"flock_law_{digest[7:23]}", f"The laws in {file}.")
    module.__file__ = str(file)
    sys.modules[module.__name__] = module
    try:
        exec(compile(source, str(file), "exec"), module.__dict__)
    except (Exception, SystemExit) as error:
        del sys.modules[module.__name__]
        raise FlockError(f"law file {file}{_line_of(error, file)}: {_told(error)}") from error
    return module


def _line_of(error: BaseException, file: Path) -> str:
    """Return ", line N", where an error of the file was raised."""
    line = error.lineno if isinstance(error, SyntaxError) else None
    for frame in traceback.extract_tb(error.__traceback__):
        if frame.filename == str(file):
            line = frame.lineno
    return f", line {line}" if line else ""


def _told(error: BaseException) -> str:
    message = error.msg if isinstance(error, SyntaxError) else str(error)
    return " ".join(f"{type(error).__name__}: {message}".split())


def _function_in(module: ModuleType, name: str, called: str, file: Path) -> Law:
    found = getattr(module, name, None)
    found = getattr(found, "py_func", found)  # a law may be a function that numba has compiled
    if not inspect.isfunction(found):
        functions = [
            key
            for key, value in vars(module).items()
            if inspect.isfunction(value) and not key.startswith("_")
        ]
        hint = nearest(name, functions) if functions else "it has no function"
        raise FlockError(f"{called}: {file} has no function {name!r}: {hint}")
    return found


def _installed(name: str) -> tuple[Law, str]:
    """Return the law of an installed package, and the digest of its source."""
    points = {point.name: point for point in entry_points(group=GROUP)}
    if name.endswith(".py"):
        raise FlockError(f"forcing: {name} is a file: name a law in it, as {name}:LAW")
    if name not in points:
        known = [*BUILT_IN, *points, *own_laws()]
        raise FlockError(f"forcing: unknown model {name!r}: {nearest(name, known)}")
    point = points[name]
    try:
        law: Callable[..., Any] = point.load()
    except Exception as error:
        raise FlockError(f"law {name!r} of {point.value}: {_told(error)}") from error
    if not inspect.isfunction(law):
        raise FlockError(f"law {name!r} of {point.value}: must be a function")
    return law, source_digest(law)
