# SPDX-License-Identifier: Apache-2.0
"""Python values as the text of a configuration: spans, links, forces and pushes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from numbers import Integral, Real
from typing import Any

import numpy as np
import numpy.typing as npt

from flock_sim.errors import FlockError
from flock_sim.model_text import SEPARATOR

Spans = Mapping[int, npt.ArrayLike] | npt.ArrayLike | None


class Link:
    """A link model: how birds know their neighbours.

        Link("hold", delay=5, drop=0.1)                # all links
        Link("linear", interval=10, source=3, target=4)  # what bird 4 receives from bird 3

    A value of several numbers makes a member of each. docs/model.md lists models and keys.
    """

    def __init__(
        self, model: str, *, source: int | None = None, target: int | None = None, **values: Any
    ) -> None:
        """Describe the links of the flock, or the one from bird `source` to bird `target`."""
        if (source is None) != (target is None):
            raise FlockError("Link: give both `source` and `target`, or neither for all links")
        birds = "" if source is None else f"{source}->{target}="
        self.text = birds + _model("Link", model, values)

    def __repr__(self) -> str:
        return f"<Link {self.text}>"


class Force:
    """A force besides thrust and drag: a built-in law, or one of your own.

        Force("gust", std=2e-5, seed=7)                    # on all birds
        Force("sine", amplitude=1e-4, period=400, bird=7)
        Force("my_laws.py:keeper", gap=0.8)                # the function `keeper` of a file

    A value of several numbers makes a member of each. docs/extending.md tells how to write a law.
    """

    def __init__(self, law: str, *, bird: int | None = None, **values: Any) -> None:
        """Describe a force on all birds, or on `bird`."""
        if bird is not None and not isinstance(bird, Integral):
            raise FlockError(
                f"Force: bird = {bird!r}: must be one whole number, or left out for all"
            )
        self.text = ("" if bird is None else f"{bird}=") + _model("Force", law, values)

    def __repr__(self) -> str:
        return f"<Force {self.text}>"


@dataclass(frozen=True)
class Push:
    """A change of a bird's position, in b, and speed, in U_min, at the beginning of a step."""

    bird: int
    step: int
    position: float = 0.0
    speed: float = 0.0
    member: int | None = None
    """Number of the member, from 1; None for all members."""

    @property
    def text(self) -> str:
        """The push as an entry of `perturbations`."""
        member = "" if self.member is None else f":{self.member}"
        change = f"{number('position', self.position)},{number('speed', self.speed)}"
        return f"{self.bird}{member}@{self.step}={change}"


def number(name: str, value: Any) -> str:
    """Return the text of a number that is read as the same number."""
    if isinstance(value, np.ndarray) and value.ndim == 0:
        value = value.item()
    if isinstance(value, Integral):
        return str(int(value))
    if isinstance(value, Real):
        return repr(float(value))
    raise FlockError(f"{name} = {value!r}: must be a number")


def texts(name: str, entries: Any, kind: type[Link] | type[Force] | type[Push]) -> list[str]:
    """Return the text of one entry or of several. Each is a `kind`, or text of a configuration."""
    several = [entries] if isinstance(entries, (str, kind)) else entries
    if not isinstance(several, Iterable):
        raise FlockError(f"{name} = {entries!r}: must be a list of {kind.__name__} or of text")
    found = []
    for entry in several:
        if not isinstance(entry, (str, kind)):
            raise FlockError(f"{name}: {entry!r} must be a {kind.__name__} or text")
        found.append(entry if isinstance(entry, str) else entry.text)
    return found


def span_texts(spans: Spans, birds: int) -> list[str]:
    """Return the entries of `span_ratios`.

    `spans` has the span ratio of some birds by number, or of all birds, shape (birds,) or (birds,
    members). Several values for a bird make members.
    """
    if spans is None:
        return []
    if not isinstance(spans, Mapping):
        ratio = np.asarray(spans)
        if ratio.ndim not in (1, 2) or len(ratio) != birds:
            raise FlockError(
                f"spans of shape {ratio.shape}: must have one row for each of the {birds} birds, "
                "or be a dictionary such as {3: 0.95}"
            )
        spans = {bird: row for bird, row in enumerate(ratio, start=1)}
    return [
        f"{number('bird', bird)}={','.join(_numbers(f'spans[{bird}]', row))}"
        for bird, row in spans.items()
    ]


def _model(called: str, name: str, values: Mapping[str, Any]) -> str:
    """Return the text of a model and its values."""
    items = [
        f"{key}={value if isinstance(value, str) else SEPARATOR.join(_numbers(key, value))}"
        for key, value in values.items()
    ]
    if not isinstance(name, str):
        raise FlockError(f"{called}: {name!r} must be the name of a model")
    return name + (f":{','.join(items)}" if items else "")


def _numbers(name: str, value: Any) -> Sequence[str]:
    return [number(name, one) for one in np.atleast_1d(np.asarray(value)).tolist()]
