# SPDX-License-Identifier: Apache-2.0
"""Common to all tests: an environment that is restored after each test, and hypothesis profiles.

By default, hypothesis searches repeatably. `--hypothesis-profile=search` tries more examples. The
fixture `terminal` is on a ROS domain of its own. The fixture `visitor` is on that domain, too.
"""

from __future__ import annotations

import gc
import os
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING
from unittest.mock import patch

import pytest
from hypothesis import HealthCheck, settings

from flock_sim.console.fault import TRACEBACK
from support.terminal import Terminal, open_terminal

if TYPE_CHECKING:
    from support.visitor import Visitor

# No deadline: the first example of a kernel compiles it, and machines differ.
# No database: the same tree gives the same verdict, regardless of earlier runs.
settings.register_profile("repeatable", deadline=None, derandomize=True, database=None)
settings.register_profile(
    "search",
    deadline=None,
    database=None,
    max_examples=3000,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile("repeatable")


@pytest.fixture(autouse=True)
def _own_environment() -> Iterator[None]:
    """Restore the environment, which tools that run in this process change.

    Otherwise, a later test would use the DDS settings of an earlier one. An exception that no tool
    has foreseen is raised, so that no test takes the line on it for an error of the user.
    """
    with patch.dict(os.environ, {TRACEBACK: "1"}):
        yield


@pytest.fixture
def terminal(tmp_path: Path) -> Iterator[Terminal]:
    """A terminal. At its end, all processes and files of its tools must be gone."""
    with open_terminal(tmp_path / "terminal") as opened:
        yield opened


@pytest.fixture
def visitor(terminal: Terminal, monkeypatch: pytest.MonkeyPatch) -> Iterator[Visitor]:
    """A node of this process, on the domain of the terminal."""
    from support.visitor import visiting  # most tests do not use ROS

    with visiting(terminal, monkeypatch) as visitor:
        yield visitor


def pytest_collection_finish() -> None:
    """Collect garbage less often, and none of modules and tests: that takes a tenth of the time."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(50_000, 20, 100)
