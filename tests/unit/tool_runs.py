# SPDX-License-Identifier: Apache-2.0
"""Tools run within a test, as their users see them."""

import json
from collections.abc import Callable, Sequence
from typing import Any

import pytest

from flock_sim.command_line import run_tool

Tool = Callable[[Sequence[str]], int]


def json_of(tool: Tool, capsys: pytest.CaptureFixture[str], *arguments: str) -> dict[str, Any]:
    """Return the one JSON object on stdout, strictly read; nothing else may be said."""
    assert run_tool(tool, [*arguments, "--json"]) == 0
    told = capsys.readouterr()
    assert told.err == ""
    value = json.loads(told.out, parse_constant=pytest.fail)
    assert isinstance(value, dict)
    return value


def text_of(tool: Tool, capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """Return what a tool that must end well prints."""
    assert run_tool(tool, arguments) == 0
    return capsys.readouterr().out


def error_of(tool: Tool, capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """Return the one line that bad input gets."""
    assert run_tool(tool, arguments) == 2
    told = capsys.readouterr()
    assert told.out == ""
    assert told.err.startswith("error: ")
    assert told.err.count("\n") == 1
    return told.err
