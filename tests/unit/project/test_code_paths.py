# SPDX-License-Identifier: Apache-2.0
"""The functions that docs/architecture.md lists as paths through the code exist."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
SOURCES = ROOT / "src" / "flock_sim" / "flock_sim"

ITEM = re.compile(r"(\d+)\. `([\w/]+\.py)` `([\w.]+)`: \w.*\.")


def paths() -> dict[str, list[str]]:
    """Return the numbered lines of each path, by its heading."""
    text = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    section = text.partition("\n## Paths through the code\n")[2].partition("\n## ")[0]
    _, *parts = re.split(r"^### ", section, flags=re.MULTILINE)
    return {
        part.partition("\n")[0]: [line for line in part.splitlines() if line[:1].isdigit()]
        for part in parts
    }


PATHS = paths()


def defined(module: str) -> set[str]:
    """Return the functions and methods of a module, such as `measure` and `Run.at`."""
    package, _, rest = module.partition("/")
    tools = ROOT / "src" / "flock_tools" / "flock_tools"
    file = tools / rest if package == tools.name else SOURCES / module
    functions = ast.FunctionDef | ast.AsyncFunctionDef
    found = set()
    for node in ast.parse(file.read_text(encoding="utf-8")).body:
        if isinstance(node, functions):
            found.add(node.name)
        elif isinstance(node, ast.ClassDef):
            found |= {
                f"{node.name}.{each.name}" for each in node.body if isinstance(each, functions)
            }
    return found


def test_the_paths_of_a_recorded_row_and_of_a_stage_message_are_listed() -> None:
    assert len(PATHS["The path of a recorded row"]) > 20
    assert len(PATHS["The path of a stage message"]) > 10


@pytest.mark.parametrize("path", PATHS)
def test_each_function_of_a_path_exists_and_is_listed_once(path: str) -> None:
    listed = []
    for number, line in enumerate(PATHS[path], start=1):
        item = ITEM.fullmatch(line)
        assert item, line
        assert int(item[1]) == number, line
        assert item[3] in defined(item[2]), line
        listed.append((item[2], item[3]))
    assert len(listed) == len(set(listed))
