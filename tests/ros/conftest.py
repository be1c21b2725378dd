# SPDX-License-Identifier: Apache-2.0
"""A ROS context in this process, on a domain of its own."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest
import rclpy
from rclpy.context import Context

from flock_sim.ros.log import ros_context
from support.terminal import own_domain, ports
from support.visitor import tell_fast_dds


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    here = Path(__file__).parent
    for item in items:
        if here in item.path.parents:
            item.add_marker(pytest.mark.ros)


@pytest.fixture(autouse=True)
def _closes_what_it_opens() -> Iterator[None]:
    """Check that a test closes all of its ROS contexts in this process."""
    before = ports(os.getpid())
    yield
    assert ports(os.getpid()) <= before


@pytest.fixture
def context(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Context]:
    """A ROS context of this process."""
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path / "log"))
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    with own_domain() as domain:
        monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
        tell_fast_dds(monkeypatch)
        made = ros_context()
        try:
            yield made
        finally:
            rclpy.try_shutdown(context=made)
