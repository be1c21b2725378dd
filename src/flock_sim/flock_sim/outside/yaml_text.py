# SPDX-License-Identifier: Apache-2.0
"""YAML from outside: lists, maps and plain values, of limited depth and number.

`read` and `parse` are for files that users write: a value without quotes has the type that ROS 2
gives it in a parameter file, and everything ambiguous is refused. `parse_texts` is for what other
programs write into bags: all values are texts.

The document is built from the events of the parser, not by PyYAML's loaders: their recursion, tags,
merge keys and copies of aliases have no limits, and that of libyaml crashes the process.
"""

from __future__ import annotations

import re
from collections.abc import Callable
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


@dataclass(slots=True)
class _Collection:
    """A list or map that is being read."""

    anchor: str | None
    event: Any
    """The event that began it, which has its line."""
    first: int
    """Number of values before it."""
    is_map: bool
    items: list[Any]
    """The items of a list; the keys and values of a map in turn."""
    keys: set[str]
    """The keys of a map so far."""
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
    return _parse(text, _Builder(MOST_VALUES))


def parse_texts(text: str, most: int = MOST_VALUES) -> Any:
    """Return a YAML document as dict, list and str, None if there is none.

    Tags are ignored, and so are keys that are no texts and all documents but the first. Of equal
    keys, the last one counts. Raises FlockError, which names the line, if it is not YAML or exceeds
    a limit; `most` is that of the number of values.
    """
    return _parse(text, _Builder(most, strict=False))


def _parse(text: str, builder: _Builder) -> Any:
    try:
        return builder.document(text)
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
    """Builds a document from the events of the parser; it has at most `most` values.

    If it is not `strict`, it makes a text of every value, and objects to nothing.
    """

    def __init__(self, most: int, strict: bool = True) -> None:
        self._most = most
        self._strict = strict
        self._count = 0
        self._event: Any = None
        """The event that is handled."""
        self._open = [_Collection(None, None, 0, False, [], set(), 0)]
        self._anchors: dict[str, _Anchored | None] = {}
        """None stands for a collection that is still open."""

    def document(self, text: str) -> Any:
        """Return the first document of `text`, None if there is none."""
        handlers: dict[type[yaml.Event], Callable[[Any], None]] = {
            yaml.ScalarEvent: self._scalar,
            yaml.SequenceStartEvent: self._begin,
            yaml.SequenceEndEvent: self._end,
            yaml.MappingStartEvent: self._begin,
            yaml.MappingEndEvent: self._end,
            yaml.AliasEvent: self._alias,
        }
        documents = 0
        for event in yaml.parse(text, Loader=yaml.CBaseLoader):
            self._event = event
            if handle := handlers.get(type(event)):
                handle(event)
            elif isinstance(event, yaml.DocumentStartEvent):
                documents += 1
                if documents > 1:
                    self._object("a second document begins; give only one")
                    break
        return self._open[0].items[0] if self._open[0].items else None

    def _scalar(self, event: yaml.ScalarEvent) -> None:
        self._take(1)
        value: Any = event.value
        if self._strict:
            as_text = event.tag in _TEXT_TAGS or not event.implicit[0]
            if event.tag not in (None, *_TEXT_TAGS):
                self._object(_unknown_tag(event.tag))
            if not as_text and not self._at_key():
                value = self._plain(value)
            elif not as_text and value == "<<":
                self._object("<< is not known; write the values out")
        self._put(value)
        if event.anchor is not None:
            self._anchors[event.anchor] = _Anchored(value, 1, 0)

    def _begin(self, event: yaml.CollectionStartEvent) -> None:
        self._take(1)
        is_map = isinstance(event, yaml.MappingStartEvent)
        if event.tag not in (None, "!", f"tag:yaml.org,2002:{'map' if is_map else 'seq'}"):
            self._object(_unknown_tag(event.tag))
        depth = len(self._open)
        self._check_depth(depth)
        if event.anchor is not None:
            self._anchors[event.anchor] = None
        self._open.append(
            _Collection(event.anchor, event, self._count - 1, is_map, [], set(), depth)
        )

    def _end(self, _: yaml.CollectionEndEvent) -> None:
        done = self._open.pop()
        depth = done.deepest - len(self._open) + 1
        value = _map(done.items) if done.is_map else done.items
        if done.anchor is not None:
            self._anchors[done.anchor] = _Anchored(value, self._count - done.first, depth)
        self._event = done.event
        self._put(value)
        self._open[-1].deepest = max(self._open[-1].deepest, done.deepest)

    def _alias(self, event: yaml.AliasEvent) -> None:
        anchor = event.anchor
        if anchor is None or anchor not in self._anchors:
            raise self._refusal(f"alias *{shown(str(anchor))}: there is no such anchor")
        meant = self._anchors[anchor]
        if meant is None:
            raise self._refusal(f"alias *{shown(anchor)}: is in the value that it stands for")
        self._take(meant.size)
        if meant.depth:
            reached = len(self._open) - 1 + meant.depth
            self._check_depth(reached)
            self._open[-1].deepest = max(self._open[-1].deepest, reached)
        self._put(meant.value)

    def _refusal(self, reason: str) -> FlockError:
        """Return the error for the current event."""
        mark = self._event.start_mark
        return FlockError(f"line {mark.line + 1 if mark else 0}: {reason}")

    def _object(self, reason: str) -> None:
        """Raise FlockError for what is clear to a parser, but ambiguous to a reader."""
        if self._strict:
            raise self._refusal(reason)

    def _take(self, values: int) -> None:
        """Count values. Raises FlockError if there are too many."""
        self._count += values
        if self._count > self._most:
            raise self._refusal(f"has more than {self._most} values, the limit; make it smaller")

    def _check_depth(self, depth: int) -> None:
        if depth > DEEPEST:
            raise self._refusal(f"is nested too deep; {DEEPEST} levels are the limit")

    def _at_key(self) -> bool:
        inner = self._open[-1]
        return inner.is_map and len(inner.items) % 2 == 0

    def _put(self, value: Any) -> None:
        """Add a value, or a key, to the innermost collection."""
        inner = self._open[-1]
        if self._strict and self._at_key():
            if not isinstance(value, str):
                self._object("a key must be text, not a list, a map or an alias")
            if value in inner.keys:
                self._object(f"{shown(value)!r} is given twice; leave one out")
            inner.keys.add(value)
        inner.items.append(value)

    def _plain(self, text: str) -> Any:
        """Return the value of a text without quotes. Raises FlockError for a long number."""
        if text in _NULL:
            return None
        if text in _TRUE:
            return True
        if text in _FALSE:
            return False
        if not (text[0].isascii() and text[0] in "+-.0123456789" and _is_number(text)):
            return text
        if len(text) > LONGEST_NUMBER:
            raise self._refusal(
                f"a number with too many digits, {len(text)}; {LONGEST_NUMBER} are the limit"
            )
        return _number(text)


def _map(items: list[Any]) -> dict[str, Any]:
    """Return a map of `items`, keys and values in turn, without keys that are no texts."""
    return {key: value for key, value in zip(items[::2], items[1::2]) if isinstance(key, str)}


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


def _unknown_tag(tag: str) -> str:
    name = tag.replace("tag:yaml.org,2002:", "!!")
    return f"tag {shown(name)}: only !!str is known; leave it out"
