# SPDX-License-Identifier: Apache-2.0
"""Standard streams that are closed, full or of another encoding end no tool with a traceback."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

TOOL = """
import os, sys
from flock_sim.console.arguments import note, print_json, print_text, run_tool
from flock_sim.errors import FlockError

def tool(arguments):
    note("a note")
    with open(os.devnull) as opened:
        assert opened.fileno() > 2, "a file has become a standard stream"
    assert sys.stdin.read() == ""
    if "bad" in arguments:
        raise FlockError("bad input")
    if "json" in arguments:
        print_json({"text": "x" * 100_000})
    elif "help" in arguments:
        from flock_sim.console.arguments import Parser
        Parser("tool", "A tool.", "none").parse_args(["--help"])
    elif "quiet" not in arguments:
        print_text(os.fsdecode(b"caf\\xe9 \\x1b]0;x\\x07 ") + "η")
    return 0

sys.exit(run_tool(tool))
"""


def ended(arguments: str, unbuffered: str = "", **environment: str) -> tuple[int, str, str]:
    """Return how a tool ended that a shell has started, and its output."""
    done = subprocess.run(
        ["/bin/sh", "-c", f'exec "$0" -P -c "$1" {arguments}', sys.executable, TOOL],
        env={**os.environ, "PYTHONUNBUFFERED": unbuffered, **environment},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    return done.returncode, done.stdout, done.stderr


@pytest.mark.parametrize("unbuffered", ["", "1"])
@pytest.mark.parametrize(
    ("arguments", "status"),
    [
        ("text <&-", 0),
        ("quiet <&- >&- 2>&-", 0),
        ("quiet >/dev/full", 0),
        ("text <&- >&- 2>&-", 1),
        ("text >&-", 1),
        ("json >&-", 1),
        ("text >/dev/full", 1),
        ("json >/dev/full", 1),
        ("help >/dev/full", 1),
        ("text >/dev/full 2>/dev/full", 1),
        ("text 2>&-", 0),
        ("text 2>/dev/full", 0),
        ("bad 2>&-", 2),
        ("bad 2>/dev/full", 2),
        ("bad <&- >&- 2>&-", 2),
    ],
)
def test_a_stream_that_is_closed_or_full_is_an_error_only_if_a_result_is_lost(
    arguments: str, status: int, unbuffered: str
) -> None:
    code, _, said = ended(arguments, unbuffered)
    assert code == status, said
    assert "Traceback" not in said
    if status == 1 and "2>" not in arguments:
        assert said.endswith("\n")
        assert said.splitlines()[-1].startswith("error: standard output can't be written: ")


@pytest.mark.parametrize("encoding", ["utf-8", "latin-1", "ascii"])
def test_what_the_encoding_of_stdout_lacks_is_escaped(encoding: str) -> None:
    code, told, said = ended("text", PYTHONIOENCODING=encoding)
    last = "η" if encoding == "utf-8" else r"\u03b7"
    assert (code, told) == (0, rf"caf\udce9 \x1b]0;x\x07 {last}" + "\n"), said
