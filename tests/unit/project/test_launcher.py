# SPDX-License-Identifier: Apache-2.0
"""Every tool can be started by ./flock, by `ros2 run`, and by the tests."""

import importlib
import re
import subprocess
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


def flock(*arguments: str) -> subprocess.CompletedProcess[str]:
    """Run ./flock."""
    command = [ROOT / "flock", *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def test_the_launcher_lists_all_executables_in_groups() -> None:
    lines = flock("--help").stdout.splitlines()
    groups = {"Fly", "Inspect", "Predict", "Live", "Nodes"}
    assert groups < set(lines)
    begin, end = lines.index("Fly"), lines.index("", lines.index("Nodes"))
    tools = [line.split()[0] for line in lines[begin:end] if line not in groups]
    assert sorted(tools) == sorted(TOOLS)


@pytest.mark.parametrize(
    ("word", "tool"), [("refrence", "reference"), ("metric", "metrics"), ("Sweep", "sweep")]
)
def test_a_tool_that_is_not_there_is_corrected(word: str, tool: str) -> None:
    done = flock(word)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith(
        f"error: there is no tool '{word}': did you mean '{tool}'? known are fly, reference, "
    )
    assert done.stderr.count("\n") == 1


def test_a_pattern_or_a_group_is_no_tool() -> None:
    for word in ("*", "Fly", "fly "):
        assert flock(word).returncode == 2


def test_the_readme_names_all_executables() -> None:
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    (row,) = re.findall(r"^\| `\./flock bird`.*$", readme, re.M)
    named = set(re.findall(r"^\| `\./flock (\w+)", readme, re.M))
    named |= set(re.findall(r"`(\w+)`", row))
    assert TOOLS.keys() <= named


@pytest.mark.parametrize("tool", sorted(set(TOOLS) - {"bird", "clock", "recorder", "fly"}))
def test_every_tool_has_a_main(tool: str) -> None:
    assert callable(importlib.import_module(TOOLS[tool]).main)
