# SPDX-License-Identifier: Apache-2.0
"""Axes of a sweep: the parameters that can be varied, their names, and their effect on a member."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from flock_sim.configuration import flock_configuration
from flock_sim.configuration.flock_configuration import LISTS
from flock_sim.configuration.key import number_of
from flock_sim.errors import FlockError, nearest
from flock_sim.forcing.registry import BUILT_IN
from flock_sim.links.keys import NUMBERS, SYNONYMS
from flock_tools.experiments.sweep.members import Member

MOST_VALUES = 100_000

RANGE_KEYS = ("from", "to", "count")

COMMON = ("birds", "record_every")
"""Configuration keys that have one value for all members."""

KEYS = {
    name: (key.meaning, key.unit)
    for name, key in flock_configuration.KEYS.items()
    if name not in (*COMMON, *LISTS)
}
"""Configuration keys that can be an axis: long name and unit. A flight has one value of each."""

LINK_KEYS = {
    "model": ("model", "1"),
    **{key: (found.meaning, found.unit) for key, found in NUMBERS.items()},
    "noise": ("noise of position and speed", "b, U_min"),
    "quantum": ("quantum of position and speed", "b, U_min"),
}
"""Keys of a link: long name and unit."""

STARTS = {"position": ("b", "{value},0"), "speed": ("U_min", "0,{value}")}
"""Quantities of a bird that a perturbation can change at the start: unit, and perturbation."""

KNOWN = (
    *("span_ratio[I]", "position[I]", "speed[I]", "link.KEY", "link[I:J].KEY"),
    *("forcing.LAW.KEY", "forcing[I].LAW.KEY", *KEYS),
)

_RATIO = re.compile(r"span_ratio\[(\d+)\]|lambda_(\d+)")
_START = re.compile(r"(position|speed)\[(\d+)\]")
_LINK = re.compile(r"link(?:\[(\d+)(?:->|:)(\d+)\])?\.(\w+)")
_FORCING = re.compile(r"forcing(?:\[(\d+)\])?\.(\w+)\.(\w+)")

Value = float | str


@dataclass(frozen=True)
class Axis:
    """A parameter that differs among members, and its values."""

    name: str
    """Name in the sweep file, such as span_ratio[2]."""
    dimension: str
    """Name in a dataset, such as span_ratio_2."""
    long_name: str
    units: str
    values: tuple[Value, ...]
    vary: Callable[[Member, Value], Member]
    single: bool = False
    """Whether it varies one link only. Such axes are applied after those of all links."""


def axis(name: str, given: Any) -> Axis:
    """Return the axis `name` with the values `given`: a list, or {from: , to: , count: }.

    Raises FlockError, which names the remedy.
    """
    called = f"axis {name!r}"
    found = _ratio(name) or _start(name) or _link(name) or _forcing(name) or _key(name)
    if found is None:
        if name in COMMON:
            raise FlockError(f"{called}: must be the same for all members; give it below `flock:`")
        of_a_link = f"did you mean 'link.{name}'?" if name in LINK_KEYS else ""
        raise FlockError(f"{called}: {of_a_link or nearest(name, KNOWN)}")
    words = name == "coupling" or name.endswith(".model")
    values = _values(called, given, words)
    twice = [value for value in values if values.count(value) > 1] if len(values) < 1000 else []
    if twice or len(set(values)) < len(values):
        raise FlockError(f"{called}: {_told(twice)}is given twice; leave one out")
    return replace(found, values=tuple(values))


def text(value: Value) -> str:
    """Return a value in the notation of a configuration."""
    return value if isinstance(value, str) else repr(value).removesuffix(".0")


def in_order(axes: Iterable[Axis]) -> list[Axis]:
    """Return axes in the order of their application: those of a single link last."""
    return sorted(axes, key=lambda one: one.single)


def _ratio(name: str) -> Axis | None:
    match = _RATIO.fullmatch(name)
    if not match:
        return None
    bird = int(match[1] or match[2])

    def vary(member: Member, value: Value) -> Member:
        return replace(member, span_ratios={**member.span_ratios, bird: text(value)})

    return Axis(name, f"span_ratio_{bird}", f"span ratio of bird {bird}", "1", (), vary)


def _start(name: str) -> Axis | None:
    match = _START.fullmatch(name)
    if not match:
        return None
    what, bird = match[1], int(match[2])
    units, change = STARTS[what]

    def vary(member: Member, value: Value) -> Member:
        push = f"@0={change.format(value=text(value))}"
        return replace(member, pushes=(*member.pushes, (bird, push)))

    told = f"change of the initial {what} of bird {bird}"
    return Axis(name, f"initial_{what}_{bird}", told, units, (), vary)


def _link(name: str) -> Axis | None:
    match = _LINK.fullmatch(name)
    if not match:
        return None
    source, target, key = match.groups()
    if key not in LINK_KEYS:
        raise FlockError(f"axis {name!r}: unknown key {key!r}: {nearest(key, LINK_KEYS, SYNONYMS)}")
    birds = f"{int(source)}->{int(target)}" if source else ""

    def vary(member: Member, value: Value) -> Member:
        return member.having_link(birds, key, text(value))

    whose = f"{int(source)}_{int(target)}_" if source else ""
    long_name, units = LINK_KEYS[key]
    long_name += f" of link {birds}" if source else " of all links"
    name = name.replace(":", "->")  # one name, so that the sweeps of both names are equal
    return Axis(name, f"link_{whose}{key}", long_name, units, (), vary, bool(source))


def _forcing(name: str) -> Axis | None:
    match = _FORCING.fullmatch(name)
    if not match:
        return None
    number, law, key = match.groups()
    bird = str(int(number)) if number else ""

    def vary(member: Member, value: Value) -> Member:
        return member.having_forcing(bird, law, key, text(value))

    whose = f"{bird}_" if bird else ""
    model = BUILT_IN.get(law)
    known = model.keys.get(key) if model else None
    long_name = f"{known.meaning if known else key} of {law}" + (f", bird {bird}" if bird else "")
    units = known.unit if known else "1"
    return Axis(name, f"forcing_{whose}{law}_{key}", long_name, units, (), vary, bool(bird))


def _key(name: str) -> Axis | None:
    if name not in KEYS:
        return None

    def vary(member: Member, value: Value) -> Member:
        return replace(member, plain={**member.plain, name: value})

    return Axis(name, name, *KEYS[name], (), vary)


def _values(called: str, given: Any, words: bool) -> list[Value]:
    if isinstance(given, Mapping) and not words:
        return _range(called, given)
    if not isinstance(given, list):
        form = "a list" if words else "a list, or {from: , to: , count: }"
        raise FlockError(f"{called}: values {given!r} must be {form}")
    if not given:
        raise FlockError(f"{called}: has no values; give one or more")
    if not words:
        return [_number(called, value) for value in given]
    for value in given:
        if not isinstance(value, str):
            raise FlockError(f"{called}: value {value!r} must be text")
    return list(given)


def _range(called: str, given: Mapping[Any, Any]) -> list[Value]:
    """Return evenly spaced values that include both ends."""
    for key in given:
        if key not in RANGE_KEYS:
            raise FlockError(f"{called}: unknown key {key!r}: {nearest(str(key), RANGE_KEYS)}")
    for key in RANGE_KEYS:
        if key not in given:
            raise FlockError(f"{called}: {key!r} is missing; give from, to and count")
    low, high, count = (_number(called, given[key]) for key in RANGE_KEYS)
    if not (math.isfinite(low) and math.isfinite(high)):
        raise FlockError(f"{called}: from {low:g} to {high:g}: must be finite")
    if not (count.is_integer() and 1 <= count <= MOST_VALUES):
        raise FlockError(f"{called}: count {count:g}: must be a whole number, 1..{MOST_VALUES}")
    if count == 1 and low != high:
        raise FlockError(
            f"{called}: count 1: is too few for both {text(low)} and {text(high)}; give 2 or more"
        )
    return [float(value) for value in np.linspace(low, high, int(count))]


def _number(called: str, value: Any) -> float:
    try:
        return number_of(value)
    except ValueError:
        raise FlockError(f"{called}: value {value!r} must be a number") from None


def _told(values: list[Value]) -> str:
    return f"{text(values[0])} " if values else "a value "
