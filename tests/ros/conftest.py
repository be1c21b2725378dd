# SPDX-License-Identifier: Apache-2.0
"""A terminal, or a ROS context in this process, for every test; each on a domain of its own.

A visitor of a terminal is on the domain of the terminal.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest
import rclpy
from rclpy.context import Context

from flock_sim.nodes.process import ros_context
from terminal import Terminal, open_terminal, own_domain, ports
from visitor import Visitor, tell_fast_dds, visiting


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    here = Path(__file__).parent
    for item in items:
        if here in item.path.parents:
            item.add_marker(pytest.mark.ros)


@pytest.fixture(autouse=True)
def _closes_what_it_opens() -> Iterator[None]:
    """See that a test leaves none of its ROS contexts open in this process."""
    before = ports(os.getpid())
    yield
    assert ports(os.getpid()) <= before


@pytest.fixture
def terminal(tmp_path: Path) -> Iterator[Terminal]:
    """A terminal; at its end nothing may be left of what was started in it."""
    with open_terminal(tmp_path / "terminal") as opened:
        yield opened


@pytest.fixture
def visitor(terminal: Terminal, monkeypatch: pytest.MonkeyPatch) -> Iterator[Visitor]:
    """A node of this process, on the domain of the terminal."""
    with visiting(terminal, monkeypatch) as visitor:
        yield visitor


@pytest.fixture
def context(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Context]:
    """A ROS context of this process."""
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path / "log"))
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    with own_domain() as domain:
        monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
        tell_fast_dds(monkeypatch)
        made = ros_context(["--ros-args", "--disable-external-lib-logs"])
        try:
            yield made
        finally:
            rclpy.try_shutdown(context=made)
