# SPDX-License-Identifier: Apache-2.0
"""The fork server from which tests start tools, with all tools imported and kernels loaded."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Mapping
from functools import cache
from importlib.metadata import entry_points
from pathlib import Path
from unittest.mock import patch

from flock_sim.launcher.fork_server import ForkServer
from flock_sim.nodes import executables

TOOLS = {
    script.name: executables.module_of(script.name)
    if script.module == executables.__name__
    else script.module
    for script in entry_points(group="console_scripts")
    if script.module.startswith(("flock_sim.", "flock_tools."))
}
"""Every tool, and its module."""


PRELOAD = 600.0
"""Longest wait for the server, which imports everything on a possibly busy machine, in s."""


@cache
def fork_server() -> ForkServer:
    """Return the server of this process. It ends with the process."""
    return spawn_server({})


def spawn_server(environment: Mapping[str, str]) -> ForkServer:
    """Return a new server, which starts with `environment` in addition to that of this process."""
    with patch.dict("os.environ", {"PYTHONPATH": _path(), **environment}):
        return ForkServer.spawn("support.forked:preload", timeout=PRELOAD)


def preload() -> None:
    """Load all modules and kernels that a tool may need."""
    import matplotlib.pyplot  # noqa: F401
    import scipy.optimize  # noqa: F401
    import xarray  # noqa: F401

    from flock_sim.configuration.choices import COUPLINGS
    from flock_sim.launcher import precompile
    from flock_sim.launcher.preload import preload

    for module in TOOLS.values():
        importlib.import_module(module)
    precompile.warm_reference()
    for coupling in COUPLINGS:
        precompile.warm_equilibrium(coupling)
    precompile.warm_stability()
    precompile.warm_integral()
    preload()


def _path() -> str:
    """Return the module search path of Python and of this file."""
    return ":".join([str(Path(__file__).parents[1]), *filter(None, sys.path)])
