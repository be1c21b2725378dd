# SPDX-License-Identifier: Apache-2.0
"""The executables of the nodes, which check the middleware before they load ROS.

ROS itself ends the process, with its own message, if the middleware is not installed.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from importlib import import_module

from flock_sim.console.arguments import run_tool
from flock_sim.ros.discovery import MIDDLEWARE, check_middleware


def module_of(node: str) -> str:
    """Return the module whose `main` runs the process of a node: `bird`, `clock` or `recorder`."""
    return f"flock_sim.nodes.{node}_process"


def _run(node: str) -> int:
    def tool(arguments: Sequence[str]) -> int:
        if {"-h", "--help"} & set(arguments):
            os.environ.pop(MIDDLEWARE, None)  # help does not need it
        check_middleware()
        return int(import_module(module_of(node)).main())

    return run_tool(tool)


def bird() -> int:
    """Run the `bird` executable."""
    return _run("bird")


def clock() -> int:
    """Run the `clock` executable."""
    return _run("clock")


def recorder() -> int:
    """Run the `recorder` executable."""
    return _run("recorder")
