# SPDX-License-Identifier: Apache-2.0
"""The command `flockflight TOOL ...`: the tools that need no ROS 2, installed by pip."""

from __future__ import annotations

import sys
from importlib import import_module
from importlib.metadata import version

from flock_sim.console import arguments
from flock_sim.console.arguments import run_tool
from flock_sim.errors import FlockError, nearest

PROGRAM = "flockflight"

GROUPS = {
    "Fly": {
        "reference": "fly a flock in one loop and record it",
        "sweep": "fly a flock for all values along axes; needs --reference here",
    },
    "Inspect": {
        "metrics": "print the metrics of a recorded flight: speed, stability, spacings, drag saved",
        "compare": "check whether two recorded flights are equal bit for bit",
        "picture": "draw the formation of a recorded flight",
        "report": "write a page on recorded flights",
        "repair": "write a valid bag from a damaged or incomplete one",
    },
    "Predict": {
        "equilibrium": "solve for the steady state of a flock: existence, spacings, stability",
        "limits": "find the span ratios or thrusts of one bird with which a flock can fly",
        "arrange": "find the order of unequal birds that is fastest, or firmest",
        "response": "compute how a flock responds to disturbances",
        "survey": "count how many random flocks can fly in formation",
        "figures": "compute and draw the figures of the paper",
    },
}
"""The tools, with their purposes."""

FOLDERS = {"reference": "flock_sim.commands"}
"""The folders of the tools that are not in flock_tools.commands."""

WITH_ROS = ("fly", "play", "watch", "view", "study", "bird", "clock", "recorder")


def main() -> int:
    """Run a tool, and return its exit status."""
    name = sys.argv[1] if len(sys.argv) > 1 else "--help"
    if name in ("-h", "--help"):
        print(described())
        return 0
    if name == "--version":
        print(f"{PROGRAM} {version('flockflight')}")
        return 0
    tools = [tool for group in GROUPS.values() for tool in group]
    if name not in tools:
        return run_tool(lambda given: _refuse(name, tools))
    arguments.program = PROGRAM
    del sys.argv[0]
    tool = import_module(f"{FOLDERS.get(name, 'flock_tools.commands')}.{name}")
    status: int = tool.main()
    return status


def described() -> str:
    """Return the list of all tools."""
    lines = [f"usage: {PROGRAM} TOOL [ARGUMENTS]"]
    for group, tools in GROUPS.items():
        lines += ["", group, *(f"  {name:12} {purpose}" for name, purpose in tools.items())]
    lines += [
        "",
        f"{PROGRAM} TOOL --help describes a tool. Flights over ROS 2 need a clone of Flock",
    ]
    return "\n".join(
        [*lines, "and its ./flock, which has more tools: " + ", ".join(WITH_ROS) + "."]
    )


def _refuse(name: str, tools: list[str]) -> int:
    if name in WITH_ROS:
        raise FlockError(f"{name} needs ROS 2: run ./flock {name} in a clone of Flock")
    raise FlockError(f"there is no tool {name!r}: {nearest(name, tools)}")


if __name__ == "__main__":
    sys.exit(main())
