# SPDX-License-Identifier: Apache-2.0
"""YAML from outside: lists, maps and plain values, of limited depth and number.

A value without quotes has the type that ROS 2 gives it in a parameter file. The document is built
from the events of the parser, not by PyYAML's loaders: their recursion, tags and copies of aliases
have no limits.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from flock_sim.errors import FlockError
from flock_sim.outside.printing import shown
from flock_sim.outside.text import read_text

DEEPEST = 64
"""Deepest nesting of lists and maps."""

MOST_VALUES = 500_000
"""Largest number of values, keys, lists and maps. An alias counts as all that it stands for."""

LONGEST_NUMBER = 400
"""Most characters of a number. The longest decimal number that is not infinite has 309 digits."""

_NULL = frozenset(("", "~", "null", "Null", "NULL"))

_TRUE, _FALSE = (
    frozenset(form for word in words for form in (word, word.capitalize(), word.upper()))
    for words in (("y", "yes", "true", "on"), ("n", "no", "false", "off"))
)

_INTEGER = re.compile(r"[-+]?(0b[01_]+|0x[0-9a-fA-F_]+|[0-9][0-9_]*)")

_FLOAT = re.compile(
    r"[-+]?([0-9][0-9_]*(\.[0-9_]*)?|\.[0-9][0-9_]*)([eE][-+]?[0-9]+)?"
    r"|[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)"
)

_BASES = {"0b": 2, "0x": 16}

_TEXT_TAGS = ("!", "tag:yaml.org,2002:str")
"""Tags that make a text of a value without quotes, as in ROS 2."""


@dataclass
class _Collection:
    """A list or map that is being read."""

    anchor: str | None
    line: int
    first: int
    """Number of values before it."""
    is_map: bool
    items: list[Any]
    """The items of a list; the keys and values of a map in turn."""
    keys: set[str]
    deepest: int
    """Depth of the deepest collection in it."""


@dataclass(frozen=True)
class _Anchored:
    """A value that aliases can stand for."""

    value: Any
    size: int
    depth: int
    """Number of nested collections, itself included."""


def read(path: Path, called: str) -> Any:
    """Return the content of a YAML file; `called` names its kind in errors.

    Raises FlockError if it can't be read or `parse` refuses it.
    """
    text = read_text(path, called)
    try:
        return parse(text)
    except FlockError as error:
        raise FlockError(f"{called} {path}: {error}") from error


def parse(text: str) -> Any:
    """Return a YAML document as dict, list, str, int, float, bool or None; keys are texts.

    Raises FlockError, which names the line, if it is not YAML, exceeds a limit, gives a key twice,
    has a tag other than !!str, or consists of several documents.
    """
    try:
        return _Builder().document(text)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark
        place = f" at line {mark.line + 1}, column {mark.column + 1}" if mark else ""
        raise FlockError(f"not YAML{place} ({error.problem or 'it cannot be read'})") from error
    except yaml.reader.ReaderError as error:
        line = text.count("\n", 0, error.position) + 1
        raise FlockError(f"not YAML near line {line} ({error.reason})") from error
    except yaml.YAMLError as error:
        raise FlockError(f"not YAML ({error})") from error


class _Builder:
    """Builds a document from the events of the parser."""

    def __init__(self) -> None:
        self._count = 0
        self._open = [_Collection(None, 0, 0, False, [], set(), 0)]
        self._anchors: dict[str, _Anchored | None] = {}
        """None stands for a collection that is still open."""

    def document(self, text: str) -> Any:
        """Return the only document of `text`, None if there is none."""
        documents = 0
        for event in yaml.parse(text, Loader=yaml.CBaseLoader):
            line = event.start_mark.line + 1 if event.start_mark else 0
            if isinstance(event, yaml.ScalarEvent):
                self._scalar(event, line)
            elif isinstance(event, yaml.CollectionStartEvent):
                self._begin(event, line)
            elif isinstance(event, yaml.CollectionEndEvent):
                self._end()
            elif isinstance(event, yaml.AliasEvent):
                self._alias(event.anchor, line)
            elif isinstance(event, yaml.DocumentStartEvent):
                documents += 1
                if documents > 1:
                    raise FlockError(f"line {line}: a second document begins; give only one")
        return self._open[0].items[0] if self._open[0].items else None

    def _scalar(self, event: yaml.ScalarEvent, line: int) -> None:
        self._take(1, line)
        as_text = event.tag in _TEXT_TAGS or not event.implicit[0]
        if event.tag not in (None, *_TEXT_TAGS):
            raise _unknown_tag(event.tag, line)
        if self._at_key() and event.value == "<<" and not as_text:
            raise FlockError(f"line {line}: << is not known; write the values out")
        if as_text or self._at_key():
            value: Any = event.value
        else:
            value = _plain(event.value, line)
        self._put(value, line)
        if event.anchor is not None:
            self._anchors[event.anchor] = _Anchored(value, 1, 0)

    def _begin(self, event: yaml.CollectionStartEvent, line: int) -> None:
        self._take(1, line)
        is_map = isinstance(event, yaml.MappingStartEvent)
        if event.tag not in (None, "!", f"tag:yaml.org,2002:{'map' if is_map else 'seq'}"):
            raise _unknown_tag(event.tag, line)
        self._check_depth(len(self._open), line)
        if event.anchor is not None:
            self._anchors[event.anchor] = None
        self._open.append(
            _Collection(event.anchor, line, self._count - 1, is_map, [], set(), len(self._open))
        )

    def _end(self) -> None:
        done = self._open.pop()
        depth = done.deepest - len(self._open) + 1
        value = dict(zip(done.items[::2], done.items[1::2])) if done.is_map else done.items
        if done.anchor is not None:
            self._anchors[done.anchor] = _Anchored(value, self._count - done.first, depth)
        self._put(value, done.line)
        self._open[-1].deepest = max(self._open[-1].deepest, done.deepest)

    def _alias(self, anchor: str | None, line: int) -> None:
        if anchor is None or anchor not in self._anchors:
            raise FlockError(f"line {line}: alias *{shown(str(anchor))}: there is no such anchor")
        meant = self._anchors[anchor]
        if meant is None:
            raise FlockError(
                f"line {line}: alias *{shown(anchor)}: is in the value that it stands for"
            )
        self._take(meant.size, line)
        if meant.depth:
            reached = len(self._open) - 1 + meant.depth
            self._check_depth(reached, line)
            self._open[-1].deepest = max(self._open[-1].deepest, reached)
        self._put(meant.value, line)

    def _take(self, values: int, line: int) -> None:
        """Count values. Raises FlockError if there are too many."""
        self._count += values
        if self._count > MOST_VALUES:
            raise FlockError(
                f"line {line}: has more than {MOST_VALUES} values, the limit; make it smaller"
            )

    def _check_depth(self, depth: int, line: int) -> None:
        if depth > DEEPEST:
            raise FlockError(f"line {line}: is nested too deep; {DEEPEST} levels are the limit")

    def _at_key(self) -> bool:
        inner = self._open[-1]
        return inner.is_map and len(inner.items) % 2 == 0

    def _put(self, value: Any, line: int) -> None:
        """Add a value, or a key, to the innermost collection."""
        inner = self._open[-1]
        if self._at_key():
            if not isinstance(value, str):
                raise FlockError(f"line {line}: a key must be text, not a list, a map or an alias")
            if value in inner.keys:
                raise FlockError(f"line {line}: {shown(value)!r} is given twice; leave one out")
            inner.keys.add(value)
        inner.items.append(value)


def _plain(text: str, line: int) -> Any:
    """Return the value of a text without quotes."""
    if text in _NULL:
        return None
    if text in _TRUE:
        return True
    if text in _FALSE:
        return False
    if not (text[0].isascii() and text[0] in "+-.0123456789" and _is_number(text)):
        return text
    if len(text) > LONGEST_NUMBER:
        raise FlockError(
            f"line {line}: a number with too many digits, {len(text)}; {LONGEST_NUMBER} are the "
            "limit"
        )
    return _number(text)


def _is_number(text: str) -> bool:
    return (_INTEGER.fullmatch(text) or _FLOAT.fullmatch(text)) is not None


def _number(text: str) -> int | float | str:
    """Return a number, or the text if it is none after all, such as `0b_` and `089`."""
    plain = text.replace("_", "").lower()
    unsigned = plain.lstrip("+-")
    if _INTEGER.fullmatch(text):
        octal = unsigned[0] == "0" and unsigned != "0"
        base = _BASES.get(unsigned[:2], 8 if octal else 10)
        try:
            return int(plain, base)
        except ValueError:
            return text
    if unsigned in (".inf", ".nan"):
        plain = plain.replace(".", "")
    return float(plain)


def _unknown_tag(tag: str, line: int) -> FlockError:
    name = tag.replace("tag:yaml.org,2002:", "!!")
    return FlockError(f"line {line}: tag {shown(name)}: only !!str is known; leave it out")
