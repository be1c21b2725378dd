# SPDX-License-Identifier: Apache-2.0
"""Runs `play` on bags of other programs, without ROS."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from flock_sim.console.arguments import run_tool
from flock_tools.commands.play import tool
from flock_tools.playback.loop import NotPublishable
from flock_tools.playback.player import check_cdr
from flock_tools.playback.topics import Selection
from flock_tools.runs import replay
from support.foreign import Channel, Message, profile, word

WORDS = Channel("/words")
LATCHED = profile(1, "transient_local")


def words(*times: float, channel: Channel = WORDS) -> list[Message]:
    """Return messages whose texts are their recorded times."""
    return [(channel, time, word(f"at {time:g} s")) for time in times]


def heard(*messages: Message) -> list[tuple[str, bytes]]:
    return [(channel.topic, data) for channel, _, data in messages]


class Played:
    """The notes of `play` on a bag, and its published messages, without ROS."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
        self.heard: list[tuple[str, bytes]] = []
        self.ticks: list[int] = []
        self.selection: Selection | None = None
        self.refused: Callable[[bytes], bool] = lambda data: False
        self._capsys = capsys
        monkeypatch.setattr(replay, "_player", self._player)

    def say(self, topic: str, data: bytes) -> None:
        check_cdr(data)
        if self.refused(data):
            raise NotPublishable("so it is")
        self.heard.append((topic, data))

    say_when_heard = say

    def tick(self, stamp: int) -> None:
        self.ticks.append(stamp)

    def meet(self, stop: object) -> None:
        pass

    wait_until_heard = serve = meet

    def __call__(self, bag: Path, *options: str) -> dict[str, Any]:
        """Play. The exit status must be 0."""
        self.heard.clear()
        assert run_tool(tool, [str(bag), "--rate", "0", "--json", *options]) == 0
        told = self._capsys.readouterr()
        self.notes = told.err.splitlines()
        return dict(json.loads(told.out))

    def error(self, bag: Path, *options: str) -> str:
        """Play. The tool must refuse with one line, which is returned."""
        assert run_tool(tool, [str(bag), "--rate", "0", *options]) == 2
        (line,) = self._capsys.readouterr().err.splitlines()
        assert line.startswith("error: ")
        return line

    @contextmanager
    def _player(
        self,
        selection: Selection,
        own_birds: Sequence[str],
        clock: float | None,
        ros_arguments: Sequence[str],
    ) -> Iterator[tuple[Any, Callable[[], None]]]:
        self.selection = selection
        self.clock = clock
        yield self, lambda: None
