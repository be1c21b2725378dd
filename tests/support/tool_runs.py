# SPDX-License-Identifier: Apache-2.0
"""Runs of tools within the test process, with checks of their output."""

import json
from collections.abc import Callable, Sequence
from typing import Any

import pytest

from flock_sim.console.arguments import run_tool

Tool = Callable[[Sequence[str]], int]


def json_of(
    tool: Tool, capsys: pytest.CaptureFixture[str], *arguments: str, notes: str = ""
) -> dict[str, Any]:
    """Return the one JSON object on stdout, strictly parsed. Stderr must be `notes`."""
    assert run_tool(tool, [*arguments, "--json"]) == 0
    told = capsys.readouterr()
    assert told.err == notes
    value = json.loads(told.out, parse_constant=pytest.fail)
    assert isinstance(value, dict)
    return value


def text_of(tool: Tool, capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """Return the output of a tool that must end without an error."""
    assert run_tool(tool, arguments) == 0
    return capsys.readouterr().out


def error_of(tool: Tool, capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """Return the single error line of a tool with bad input."""
    assert run_tool(tool, arguments) == 2
    told = capsys.readouterr()
    assert told.out == ""
    assert told.err.startswith("error: ")
    assert told.err.count("\n") == 1
    return told.err
