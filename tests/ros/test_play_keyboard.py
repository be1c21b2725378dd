# SPDX-License-Identifier: Apache-2.0
"""The keyboard of a real terminal controls a playback, and the terminal is restored."""

from __future__ import annotations

import fcntl
import os
import pty
import termios
from collections.abc import Iterator
from typing import Any

import pytest

from flock_interfaces import srv
from flock_interfaces.msg import BirdState
from flock_sim.messages import topics
from support.terminal import Job, Terminal
from support.visitor import Visitor

RIGHT, UP, DOWN = b"\x1b[C", b"\x1b[A", b"\x1bOB"
"""As terminals send them; the last in the mode of applications."""


@pytest.fixture
def screen() -> Iterator[tuple[int, int]]:
    """The two ends of a new terminal, that of the keys and that of programs, which restore it."""
    keys, program = pty.openpty()
    try:
        before = termios.tcgetattr(program)
        yield keys, program
        assert termios.tcgetattr(program) == before
    finally:
        os.close(keys)
        os.close(program)


def play_on(screen: int, terminal: Terminal, *options: str) -> Job:
    """Start to play a bag in a process that is controlled by the terminal `screen`."""
    terminal.well("reference", "--birds", 2, "--t-max", 100, "--output", "bag")
    return terminal.start(
        *("play", "bag", *options),
        stdin=screen,
        preexec_fn=lambda: fcntl.ioctl(0, termios.TIOCSCTTY, 0),
    )


def test_keys_pause_step_change_the_rate_and_end(
    terminal: Terminal, visitor: Visitor, screen: tuple[int, int]
) -> None:
    keys, program = screen
    heard = visitor.hear(BirdState, topics.state_topic(1), raw=True)
    job = play_on(program, terminal, "--paused", "--topics", topics.state_topic(1))
    job.until_said("space: pause")

    def ask(kind: Any, name: str) -> Any:
        return visitor.ask(kind, f"/flock/player/{name}")

    visitor.until(lambda: all(s.get_publisher_count() for s in visitor.node.subscriptions))
    os.write(keys, RIGHT)
    visitor.until(lambda: len(heard) == 1)
    os.write(keys, RIGHT + RIGHT)
    visitor.until(lambda: len(heard) == 3)
    os.write(keys, UP + UP + DOWN + DOWN + DOWN)
    visitor.until(lambda: ask(srv.GetRate, "get_rate").rate < 0.95)
    os.write(keys, b" ")
    visitor.until(lambda: not ask(srv.IsPaused, "is_paused").paused)
    os.write(keys, b"x ")
    visitor.until(lambda: ask(srv.IsPaused, "is_paused").paused)
    os.write(keys, b"q")
    visitor.until(lambda: not job.running)
    done = job.wait()
    assert done.status == 0, done.stderr


def test_keys_have_no_effect_if_they_are_disabled(
    terminal: Terminal, visitor: Visitor, screen: tuple[int, int]
) -> None:
    keys, program = screen
    before = termios.tcgetattr(program)
    job = play_on(program, terminal, "--start-paused", "--disable-keyboard-controls")
    assert visitor.ask(srv.IsPaused, "/flock/player/is_paused").paused
    assert termios.tcgetattr(program) == before
    os.write(keys, b" q")
    done = visitor.stop_player(job)
    assert done.status == 0
    assert "space: pause" not in done.stderr
