# SPDX-License-Identifier: Apache-2.0
"""The command of the installation by pip has tools of ./flock, in the same groups."""

from importlib import import_module
from pathlib import Path

import pytest

from flock_sim.errors import FlockError
from flockflight import command

LIST = Path(__file__).resolve().parents[3] / "tools" / "list"


def groups() -> dict[str, list[str]]:
    """The tools of ./flock in their groups."""
    found: dict[str, list[str]] = {}
    for line in LIST.read_text().splitlines():
        if line.startswith("  "):
            found[list(found)[-1]].append(line.split()[0])
        elif line and not line.startswith("#"):
            found[line.split()[0]] = []
    return found


def test_tools_stand_in_the_groups_of_flock() -> None:
    known = groups()
    here = {group: list(tools) for group, tools in command.GROUPS.items()}
    assert here.keys() <= known.keys()
    for group, tools in here.items():
        assert tools == [tool for tool in known[group] if tool in tools]
    every = {tool for tools in known.values() for tool in tools}
    assert every == {tool for tools in here.values() for tool in tools} | set(command.WITH_ROS)


def test_each_tool_is_a_module_that_can_be_run() -> None:
    for tools in command.GROUPS.values():
        for name in tools:
            folder = command.FOLDERS.get(name, "flock_tools.commands")
            assert callable(import_module(f"{folder}.{name}").main)


@pytest.mark.parametrize(
    ("name", "told"),
    [("fly", "fly needs ROS 2: run ./flock fly"), ("limit", "did you mean 'limits'")],
)
def test_another_tool_is_refused_with_a_remedy(name: str, told: str) -> None:
    with pytest.raises(FlockError, match=told):
        command._refuse(name, [tool for tools in command.GROUPS.values() for tool in tools])
