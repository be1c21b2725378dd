# SPDX-License-Identifier: Apache-2.0
"""Every tool can be started by ./flock, by `ros2 run`, and by the tests."""

import importlib
import re
from pathlib import Path

import pytest

from support.terminal import TOOLS

ROOT = Path(__file__).parents[3]

EXECUTABLES = "flock_sim.nodes.executables"


def entry_points() -> dict[str, str]:
    """Return the module of each executable that the packages install.

    Those of nodes check the settings first, and only then load the module of the node.
    """
    found = {}
    for setup in ROOT.glob("src/*/setup.py"):
        text = setup.read_text(encoding="utf-8")
        for name, module, function in re.findall(r'"(\w+)=([\w.]+):(\w+)"', text):
            if module == EXECUTABLES:
                assert function == name
                assert callable(getattr(importlib.import_module(module), name))
                module = f"flock_sim.nodes.{'bird_process' if name == 'bird' else name}"
            else:
                assert function == "main"
            found[name] = module
    return found


def test_all_executables_are_known_to_the_tests() -> None:
    assert entry_points() == TOOLS


def test_the_launcher_lists_all_executables() -> None:
    table = re.search(r'tools="\\\n(.*?)"\n', (ROOT / "flock").read_text(encoding="utf-8"), re.S)
    assert table is not None
    assert {line.split()[0] for line in table[1].splitlines()} == entry_points().keys()


def test_the_readme_names_all_executables() -> None:
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    (row,) = re.findall(r"^\| `\./flock bird`.*$", readme, re.M)
    named = set(re.findall(r"^\| `\./flock (\w+)", readme, re.M))
    named |= set(re.findall(r"`(\w+)`", row))
    assert entry_points().keys() <= named


@pytest.mark.parametrize("tool", sorted(set(TOOLS) - {"bird", "clock", "recorder", "fly"}))
def test_every_tool_has_a_main(tool: str) -> None:
    assert callable(importlib.import_module(TOOLS[tool]).main)
