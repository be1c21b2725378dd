# SPDX-License-Identifier: Apache-2.0
"""No text from outside controls a terminal or fills it."""

from __future__ import annotations

from flock_sim.outside.printing import LONGEST_LINE, one_line, printable, shown


def test_control_characters_and_undecodable_bytes_are_escaped() -> None:
    assert printable("a\x1b]0;x\x07b\n\u202e\x9b\udce9η") == r"a\x1b]0;x\x07b\n\u202e\x9b\udce9η"


def test_a_long_value_is_cut() -> None:
    assert shown("x" * 60) == "x" * 60
    assert shown("x" * 61) == "x" * 60 + "..."


def test_a_long_line_keeps_its_beginning_and_its_end() -> None:
    line = one_line("name " + "x" * 10**6 + "\x1b: name another")
    assert line.startswith("name xxx")
    assert line.endswith(r"x\x1b: name another")
    assert len(line) < LONGEST_LINE + 20
