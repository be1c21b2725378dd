# SPDX-License-Identifier: Apache-2.0
"""The types of the player's services are those that its clients use."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from flock_interfaces import srv
from flock_tools.playback.message_types import service_class

SERVICES = (
    *("Pause", "Resume", "TogglePaused", "IsPaused", "SetRate", "GetRate"),
    *("Seek", "PlayNext", "Stop"),
)


@pytest.fixture
def rosbag2(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Give the file of an importable rosbag2_interfaces.srv, which does not exist yet."""
    package = tmp_path / "rosbag2_interfaces"
    package.mkdir()
    (package / "__init__.py").touch()
    monkeypatch.syspath_prepend(str(tmp_path))
    names = ("rosbag2_interfaces", "rosbag2_interfaces.srv")
    for name in names:
        monkeypatch.delitem(sys.modules, name, raising=False)
    yield package / "srv.py"
    for name in names:
        sys.modules.pop(name, None)


@pytest.mark.parametrize("name", SERVICES)
def test_the_types_of_rosbag2_are_taken_where_it_is_installed(rosbag2: Path, name: str) -> None:
    # A fake, recognised by another class of ours.
    rosbag2.write_text(f"from flock_interfaces.srv import Perturb as {name}", encoding="utf-8")
    assert service_class(name) is srv.Perturb


@pytest.mark.parametrize("content", ["Stop = object", "raise ImportError", ""])
def test_ours_are_taken_where_rosbag2_does_not_have_them(rosbag2: Path, content: str) -> None:
    # Versions before Jazzy have no Stop. An installation without compiled types has no metaclass.
    rosbag2.write_text(content, encoding="utf-8")
    assert service_class("Stop") is srv.Stop
