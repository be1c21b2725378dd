# SPDX-License-Identifier: Apache-2.0
"""Printing of text that comes from outside: names in files and messages, paths, values."""

from __future__ import annotations

LONGEST_TEXT = 60
"""Most characters of a value that are shown in an error."""

LONGEST_LINE = 4000
"""Most characters of a line on stderr. Lists of the parameters of a file stay below."""


def printable(text: str) -> str:
    """Return `text` with line ends, terminal control characters and undecodable bytes escaped."""
    if text.isprintable():
        return text
    return "".join(each if each.isprintable() else repr(each)[1:-1] for each in text)


def shown(text: str) -> str:
    """Return `text` for use in a line: printable, at most LONGEST_TEXT characters and `...`."""
    return printable(text if len(text) <= LONGEST_TEXT else f"{text[:LONGEST_TEXT]}...")


def one_line(text: str) -> str:
    """Return `text` as one line of at most LONGEST_LINE characters; a longer one has a gap."""
    if len(text) > LONGEST_LINE:
        text = f"{text[: LONGEST_LINE - 1000]} ... {text[-1000:]}"
    return printable(text)
