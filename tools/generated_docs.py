# SPDX-License-Identifier: Apache-2.0
"""Writes docs/tools.md, from what the tools say of themselves, and docs/messages.md.

`./flock python tools/generated_docs.py [DIRECTORY]`; tests/ros/test_generated_docs.py sees that
what is in docs/ is what this writes.
"""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Iterator
from contextlib import redirect_stdout, suppress
from importlib.metadata import entry_points
from io import StringIO
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent

COLUMNS = 88
"""Width of the help, in characters: what a page shows without scrolling."""

WHENCE = "<!-- Written by tools/generated_docs.py (make docs): change its sources instead. -->"


def tools_page() -> str:
    """Return docs/tools.md: all tools in the order of `./flock --help`, each with its help."""
    lines = [
        "# Tools",
        "",
        WHENCE,
        "",
        "The help of each tool, as `./flock TOOL --help` prints it. [README](../README.md#tools)",
        "lists their purposes, and the [tutorial](tutorial.md) shows their use.",
        "",
        "Exit statuses are 0, 1 (the run failed, or the answer is no), 2 (bad input), 130 (Ctrl-C)",
        "and, for all tools, 70: a fault of Flock itself, which one line describes. With",
        "`FLOCK_TRACEBACK=1` in the environment, Python prints its traceback instead. Report the",
        "line and the traceback to the authors, with the command.",
        "",
        "| | tool | |",
        "|---|---|---|",
    ]
    tools = list(_tools())
    lines += [f"| {group} | [`{tool}`](#{tool}) | {words} |" for group, tool, words in tools]
    for _, tool, _ in tools:
        lines += ["", f"## {tool}", "", "```text", _help(tool).rstrip(), "```"]
    return "\n".join(lines) + "\n"


def messages_page() -> str:
    """Return docs/messages.md: the fields of all messages and services, with their comments."""
    interfaces = ROOT / "src/flock_interfaces"
    lines = [
        "# Messages",
        "",
        WHENCE,
        "",
        "The messages and services of `flock_interfaces`, field by field. Their topics are listed",
        "in [architecture.md](architecture.md#nodes-and-topics). Values whose unit is made of b,",
        "U_min and rho are dimensionless",
        "([model.md](model.md#units-and-the-standard-bird)). N is the number of birds, M that of",
        "members: independent flocks flown at once.",
    ]
    for title, pattern in (("Messages", "msg/*.msg"), ("Services", "srv/*.srv")):
        lines += ["", f"## {title} of flock_interfaces"]
        for path in sorted(interfaces.glob(pattern)):
            lines += ["", f"### {path.stem}", "", *_definition(path.read_text(encoding="utf-8"))]
    return "\n".join(lines) + "\n"


PAGES = {"tools.md": tools_page, "messages.md": messages_page}


def _tools() -> Iterator[tuple[str, str, str]]:
    """Give the group, the name and the purpose of every tool."""
    group = ""
    for line in (ROOT / "tools" / "list").read_text(encoding="utf-8").splitlines():
        if not line.startswith(" "):
            group = line
            continue
        tool, _, words = line.strip().partition(" ")
        yield group, tool, words.strip()


def _help(tool: str) -> str:
    (entry,) = entry_points(group="console_scripts", name=tool)
    main = entry.load()
    told, arguments, columns = StringIO(), sys.argv, os.environ.get("COLUMNS")
    sys.argv, os.environ["COLUMNS"] = [tool, "--help"], str(COLUMNS)
    try:
        with redirect_stdout(told), suppress(SystemExit):
            main()
    finally:
        sys.argv = arguments
        os.environ.pop("COLUMNS")
        if columns is not None:
            os.environ["COLUMNS"] = columns
    return told.getvalue()


def _definition(text: str) -> Iterator[str]:
    """Give the lines on one message or service: what it is, and tables of its fields."""
    lines = text.splitlines()
    for line in lines:
        if line.startswith("#"):
            yield re.sub(r"docs/(\w+\.md)", r"[\1](\1)", line.removeprefix("#").strip())
    fields = [line for line in lines if line and not line.startswith("#")]
    if "---" not in fields:
        yield from _table("", fields)
        return
    middle = fields.index("---")
    yield from _table("Request", fields[:middle])
    yield from _table("Response", fields[middle + 1 :])


def _table(part: str, fields: list[str]) -> Iterator[str]:
    yield ""
    if part:
        yield f"{part}:" if fields else f"{part}: nothing."
    if not fields:
        return
    if part:
        yield ""
    yield "| field | type | meaning |"
    yield "|---|---|---|"
    for field in fields:
        declared, _, comment = field.partition("#")
        kind, name = declared.split()
        yield f"| `{name}` | `{kind}` | {comment.strip()} |"


def main() -> None:
    """Write both pages, into docs/ or where the command says."""
    directory = Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "docs"
    for name, page in PAGES.items():
        (directory / name).write_text(page(), encoding="utf-8")


if __name__ == "__main__":
    main()
