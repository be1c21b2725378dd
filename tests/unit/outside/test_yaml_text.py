# SPDX-License-Identifier: Apache-2.0
"""YAML is read as ROS 2 reads parameter files, and what exceeds a limit is refused by its line."""

from __future__ import annotations

import math
from typing import Any

import pytest

from flock_sim.errors import FlockError
from flock_sim.outside import yaml_text
from flock_sim.outside.yaml_text import parse, parse_texts


@pytest.mark.parametrize(
    ("value", "meaning"),
    [
        ("1", 1),
        ("-12", -12),
        ("1_000", 1000),
        ("0x1f", 31),
        ("0b101", 5),
        ("010", 8),
        ("089", "089"),
        ("0b_", "0b_"),
        ("1e4", 1e4),
        ("1E+4", 1e4),
        ("-.5", -0.5),
        ("1.5", 1.5),
        (".inf", math.inf),
        ("-.INF", -math.inf),
        ("inf", "inf"),
        ("yes", True),
        ("On", True),
        ("y", True),
        ("no", False),
        ("OFF", False),
        ("~", None),
        ("", None),
        ("nearest", "nearest"),
        ("3:4=hold", "3:4=hold"),
        ("'1'", "1"),
        ('"yes"', "yes"),
        ("!!str 5", "5"),
        ("! 5", "5"),
        ("2001-01-01", "2001-01-01"),
        ("1:30", "1:30"),
        ("[1, [a, 2.5]]", [1, ["a", 2.5]]),
        ("{on: 1, 2: x}", {"on": 1, "2": "x"}),
    ],
)
def test_a_value_has_the_type_that_ros_gives_it(value: str, meaning: Any) -> None:
    found = parse(f"key: {value}")["key"]
    assert found == meaning
    assert type(found) is type(meaning)


def test_not_a_number_is_read() -> None:
    assert math.isnan(parse(".nan"))


@pytest.mark.parametrize("text", ["", "# a comment\n", "---\n"])
def test_a_text_without_a_value_is_none(text: str) -> None:
    assert parse(text) is None


def test_an_alias_stands_for_the_value_of_its_anchor() -> None:
    assert parse("a: &v [1, 2]\nb: *v\nc: [*v, &w x, *w]") == {
        "a": [1, 2],
        "b": [1, 2],
        "c": [[1, 2], "x", "x"],
    }


BOMB = "a: &a [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"{name}: &{name} [{', '.join([f'*{before}'] * 9)}]\n"
    for before, name in zip("abcdefgh", "bcdefghi")
)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (BOMB, r"^line 6: has more than 500000 values, the limit"),
        (f"[{'1,' * 500_000}]", r"^line 1: has more than 500000 values"),
        ("[" * 100_000, r"^line 1: is nested too deep; 64 levels are the limit"),
        ("\n" + "{a: " * 100_000, r"^line 2: is nested too deep"),
        ("".join(f"{' ' * k}a:\n" for k in range(200)), r"^line 65: is nested too deep"),
        ("- " * 1000, r"^line 1: is nested too deep"),
        (f"a: &a {'[' * 40}{']' * 40}\nb: {'[' * 40}*a{']' * 40}", r"^line 2: is nested too deep"),
        ("a: &a [*a]", r"^line 1: alias \*a: is in the value that it stands for"),
        ("[*a]", r"^line 1: alias \*a: there is no such anchor"),
        ("a: 1\nb: !!int zz", r"^line 2: tag !!int: only !!str is known"),
        ("!!bool maybe", r"^line 1: tag !!bool"),
        ("!!timestamp never", r"^line 1: tag !!timestamp"),
        ("!!python/object:os.system {}", r"^line 1: tag !!python/object"),
        ("!!set {a}", r"^line 1: tag !!set"),
        ("a: 1\nb: 2\na: 3", r"^line 3: 'a' is given twice"),
        ("1: 1\n'1': 3", r"^line 2: '1' is given twice"),
        ("? [a]\n: 1", r"^line 1: a key must be text"),
        ("? {a: b}\n: 1", r"^line 1: a key must be text"),
        ("a: &v [1]\n? *v\n: 1", r"^line 2: a key must be text"),
        ("a: &v {b: 1}\nc: {<<: *v}", r"^line 2: << is not known"),
        ("a: " + "9" * 5000, r"^line 1: a number with too many digits, 5000; 400 are the limit"),
        ("a: -0." + "9" * 5000, r"^line 1: a number with too many digits, 5003"),
        ("a: 1\n---\nb: 1", r"^line 2: a second document begins"),
        ("a: 1\nb: [", r"^not YAML at line 3"),
        ("a:\n\t- 1", r"^not YAML at line 2"),
        ("a: '\x1b'", r"^not YAML near line 1"),
        ('a: "\\ud800"', r"^not YAML at line 1"),
        ("%YAML 9.9\n---\na: 1", r"^not YAML at line 1"),
        (f"{'k' * 1000}: 1\n{'k' * 1000}: 1", r"^(?=.{,120}$)line 2: 'k+\.\.\.' is given twice"),
    ],
    ids=range(29),
)
def test_what_is_no_data_or_exceeds_a_limit_is_refused_by_its_line(text: str, said: str) -> None:
    with pytest.raises(FlockError, match=said):
        parse(text)


def test_what_the_limits_allow_is_read() -> None:
    deep = f"{'[' * yaml_text.DEEPEST}{']' * yaml_text.DEEPEST}"
    assert parse(deep)
    assert len(parse(f"[{'1.5,' * 100_000}]")) == 100_000
    entry = "1=" + ",".join(["1.05"] * 10_000)
    assert parse(f"span_ratios: [{', '.join([repr(entry)] * 501)}]")["span_ratios"][500] == entry


def test_a_number_that_never_ends_takes_one_pass() -> None:
    digits = "1" * 1_000_000 + "x"  # a search that goes back takes 10^12 steps
    assert parse(f"a: {digits}") == {"a": digits}


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("", None),
        ("a: 1\nb: [yes, ~, 0x1, .nan, '5']", {"a": "1", "b": ["yes", "~", "0x1", ".nan", "5"]}),
        ("a:\nb: ''", {"a": "", "b": ""}),
        ("a: 1\na: 2", {"a": "2"}),
        ("? [a]\n: 1\n? {b: c}\n: 2\nd: 3", {"d": "3"}),
        ("a: !!int zz\nb: !!python/object:os.system {c: 1}", {"a": "zz", "b": {"c": "1"}}),
        ("a: &v [1]\nb: *v\nc: {<<: *v}", {"a": ["1"], "b": ["1"], "c": {"<<": ["1"]}}),
        ("a: 1\n---\nb: 1", {"a": "1"}),
        ("--- |\n  a\n", "a\n"),
        ("a: " + "9" * 5000, {"a": "9" * 5000}),
    ],
    ids=range(10),
)
def test_what_other_programs_write_is_read_as_texts(text: str, found: Any) -> None:
    assert parse_texts(text) == found


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (BOMB, r"^line 6: has more than 500000 values, the limit"),
        ("[" * 100_000, r"^line 1: is nested too deep; 64 levels are the limit"),
        (f"a: &a {'[' * 40}{']' * 40}\nb: {'[' * 40}*a{']' * 40}", r"^line 2: is nested too deep"),
        ("a: &a [*a]", r"^line 1: alias \*a: is in the value that it stands for"),
        ("[*a]", r"^line 1: alias \*a: there is no such anchor"),
        ("a: [", r"^not YAML at line 2"),
        ("a: '\x1b'", r"^not YAML near line 1"),
    ],
    ids=range(7),
)
def test_texts_have_the_same_limits(text: str, said: str) -> None:
    with pytest.raises(FlockError, match=said):
        parse_texts(text)


def test_the_number_of_texts_can_have_another_limit() -> None:
    assert parse_texts("[a, b]", 3) == ["a", "b"]
    with pytest.raises(FlockError, match="more than 3 values"):
        parse_texts("[a, b, c]", 3)


def test_each_event_of_a_long_file_is_looked_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    # A metadata.yaml of many files: the work is counted, since a time is no test.
    steps: list[int] = []
    take = yaml_text._Builder._take
    monkeypatch.setattr(
        yaml_text._Builder, "_take", lambda self, count: steps.append(count) or take(self, count)
    )
    for files in (1000, 2000):
        steps.clear()
        text = "files:\n" + "".join(f"  - path: run_{k}.mcap\n" for k in range(files))
        assert len(parse_texts(text)["files"]) == files
        assert len(steps) == 3 + 3 * files
