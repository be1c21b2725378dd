# SPDX-License-Identifier: Apache-2.0
"""Every tool can be started by ./flock, by `ros2 run`, and by the tests."""

import importlib
import re
from importlib.metadata import entry_points
from importlib.util import find_spec
from pathlib import Path

import pytest

from support.terminal import TOOLS

ROOT = Path(__file__).parents[3]

EXECUTABLES = "flock_sim.nodes.executables"


def test_every_executable_calls_the_function_that_is_its_main() -> None:
    for tool in TOOLS:
        (script,) = entry_points(group="console_scripts", name=tool)
        # Those of nodes check the middleware first, and only then load the module of the node.
        assert script.attr == (tool if script.module == EXECUTABLES else "main")
        if script.module == EXECUTABLES:
            assert callable(script.load())
            assert find_spec(TOOLS[tool])


def test_the_launcher_lists_all_executables() -> None:
    table = re.search(r'tools="\\\n(.*?)"\n', (ROOT / "flock").read_text(encoding="utf-8"), re.S)
    assert table is not None
    assert {line.split()[0] for line in table[1].splitlines()} == TOOLS.keys()


def test_the_readme_names_all_executables() -> None:
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    (row,) = re.findall(r"^\| `\./flock bird`.*$", readme, re.M)
    named = set(re.findall(r"^\| `\./flock (\w+)", readme, re.M))
    named |= set(re.findall(r"`(\w+)`", row))
    assert TOOLS.keys() <= named


@pytest.mark.parametrize("tool", sorted(set(TOOLS) - {"bird", "clock", "recorder", "fly"}))
def test_every_tool_has_a_main(tool: str) -> None:
    assert callable(importlib.import_module(TOOLS[tool]).main)
