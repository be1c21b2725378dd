# SPDX-License-Identifier: Apache-2.0
"""The text of a model and its numbers: MODEL[:KEY=VALUE[/VALUE...],...].

Several values of a key are those of the members. Link models and forcing models are written so.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass

from flock_sim.errors import FlockError, nearest

FORM = "MODEL[:KEY=VALUE[/VALUE...],...]"

SEPARATOR = "/"
"""Separator of the values of members. Commas separate keys."""


@dataclass(frozen=True)
class NumberKey:
    """A key with numbers: its meaning, its unit ("1": none), and the values that it may have."""

    meaning: str
    unit: str
    told: str
    """The values in words."""
    holds: Callable[[float], bool]
    default: float | None = 0.0
    """None: the key must be given."""


def whole(value: float) -> bool:
    """Whether a number is finite and whole."""
    return math.isfinite(value) and value == math.floor(value)


SEED = NumberKey("seed", "1", "a whole number, 0..2^53", lambda v: whole(v) and 0 <= v <= 2**53)


def items_of(settings: str) -> list[tuple[str, str]]:
    """Return each key in `settings`, the text after the model, with the text of its values."""
    items = (item.partition("=") for item in settings.split(",")) if settings else ()
    return [(key, values) for key, _, values in items]


def values_of(
    called: str,
    items: Iterable[tuple[str, str]],
    keys: Mapping[str, NumberKey],
    both: Mapping[str, Sequence[str]] | None = None,
    synonyms: Mapping[str, str] | None = None,
) -> dict[str, list[float]]:
    """Return the values of each key of `items`, one or one for each member.

    `both` are further keys, each of which sets several of `keys`. `synonyms` has the keys that
    other words mean, for errors. Raises FlockError, which begins with `called`, on a key that is
    unknown or given twice, and on a value out of range.
    """
    both = both or {}
    values: dict[str, list[float]] = {}
    for key, given in items:
        if key not in keys and key not in both:
            known = [*keys, *both]
            hint = nearest(key, known, synonyms) if known else "it has none"
            raise FlockError(f"{called}: unknown key {key!r}: {hint}")
        for single in both.get(key, (key,)):
            if single in values:
                raise FlockError(f"{called}: {single} is given twice; leave one out")
            words = given.split(SEPARATOR)
            values[single] = [_number(called, key, word, keys[single]) for word in words]
    return values


def members_of(called: str, values: Collection[tuple[str, Sequence[object]]]) -> int:
    """Return the number of members that the values of keys have.

    Raises FlockError, which begins with `called`, if they differ.
    """
    members = max((len(given) for _, given in values), default=1)
    for key, given in values:
        if len(given) not in (1, members):
            longest = next(k for k, v in values if len(v) == members)
            raise FlockError(
                f"{called}: {key} has {len(given)} values and {longest} {members}: give 1 or "
                f"{members} of each, between {SEPARATOR!r}"
            )
    return members


def _number(called: str, key: str, word: str, bounds: NumberKey) -> float:
    try:
        value = float(word)
    except ValueError:
        value = math.nan
    if not bounds.holds(value):
        raise FlockError(f"{called}: {key}={word} must be {bounds.told}")
    return value
