# SPDX-License-Identifier: Apache-2.0
"""The table of `watch` agrees with the bag."""

from __future__ import annotations

import fcntl
import os
import pty
import select
import struct
import termios

import pytest

from flock_sim.recording.run import Run
from flock_sim.ros.process import executing
from flock_tools.live.flock_monitor import Sample
from flock_tools.live.listener import Watcher
from support.bags import last_step
from support.terminal import Terminal
from support.visitor import Visitor

FLOCK = ("--birds", 3, "--t-max", 300, "--span-ratio", "1=0.95,1.0")


def test_a_played_flock_is_shown_as_it_was_recorded(terminal: Terminal) -> None:
    terminal.well("reference", *FLOCK, "--output", "bag")
    player = terminal.start("play", "bag", "--rate", 2, "--loop")
    shown = terminal.well("watch", "--json", "--member", 2, "--timeout", 60).json
    with Run(terminal.directory / "bag") as run:
        expected = run.metrics(shown["time"]).as_json()
        drag = run.at(shown["time"]).interaction_drag[:, 1].tolist()
    assert shown["step"] == expected["steps"]
    assert shown["position"] == expected["position"][1]
    assert shown["interaction_drag"] == drag
    assert shown["drag_reduction"] is None  # no clock has told what is flown
    assert (shown["birds"], shown["members"], shown["leader"]) == (3, 2, 2)
    table = terminal.well("watch", "--once", "--timeout", 60).stdout
    assert "member 1 of 2" in table
    assert "2 leader" in table
    player.interrupt()
    assert player.wait().status == 130


def test_a_flight_is_shown_with_all_that_its_clock_tells(terminal: Terminal) -> None:
    job = terminal.start("fly", "--birds", 3, "--t-max", 1e6, "--output", "flown")
    done = terminal.run("watch", "--json", "--timeout", 60)
    assert done.status == 0, done.stderr
    shown = done.json
    job.until(lambda: last_step(terminal.directory / "flown") >= shown["step"])
    job.interrupt()
    assert job.wait().status == 130
    with Run(terminal.directory / "flown") as run:
        expected = run.metrics(shown["time"]).as_json()
    assert shown["position"] == expected["position"][0]
    assert shown["drag_reduction"] == expected["drag_reduction"][0]
    assert (shown["coupling"], shown["hears"]) == ("nearest", [[2], [1, 3], [2]])


def test_one_flock_after_the_other_is_shown_as_what_it_is(
    terminal: Terminal, visitor: Visitor
) -> None:
    free = ("--mode", "free", "--real-time-factor", 20, "--coupling", "all")
    terminal.well("fly", *free, "--birds", 5, "--t-max", 300, "--output", "flown")
    terminal.well("reference", *FLOCK, "--output", "bag")
    context = visitor.node.context
    with executing("single", context) as executor:
        executor.add_node(watcher := Watcher(context))

        def shown() -> Sample | None:
            executor.spin_once(timeout_sec=0.05)
            return watcher.view.sample(watcher.birds, 1)

        for bag, *expected in (("flown", 5, "all", 300, 20.0), ("bag", 3, None, None, None)):
            player = terminal.start("play", bag, "--loop")
            visitor.until(lambda birds=expected[0]: (now := shown()) and now.birds == birds)
            visitor.until(lambda: (now := shown()) and watcher.knows(now))
            now = shown()
            assert now is not None
            told = [now.birds, now.coupling, now.end, now.real_time_factor]
            assert told == expected
            player.interrupt()
            assert player.wait().status == 130


@pytest.mark.slow
def test_keys_show_another_member_and_end_the_table(terminal: Terminal) -> None:
    flight = terminal.start("fly", *FLOCK[:2], *FLOCK[4:], "--t-max", 1e7, "--output", "flown")
    keys, screen = pty.openpty()
    try:
        before = termios.tcgetattr(screen)
        fcntl.ioctl(screen, termios.TIOCSWINSZ, struct.pack("HHHH", 50, 120, 0, 0))
        shown: list[bytes] = []
        job = terminal.start(
            *("watch", "--timeout", 60),
            stdin=screen,
            stderr=screen,
            preexec_fn=lambda: fcntl.ioctl(0, termios.TIOCSCTTY, 0),
        )

        def sees(words: str) -> bool:
            if select.select([keys], [], [], 0)[0]:
                shown.append(os.read(keys, 1 << 16))
            return words.encode() in b"".join(shown)

        job.until(lambda: sees("member 1 of 2"))
        job.until(lambda: sees("q: quit"))
        for words in ("verdict: settling since t =", "sigma_U", "position, b", "speed, U_min"):
            job.until(lambda words=words: sees(words))
        os.write(keys, b"\x1b[C")
        job.until(lambda: sees("member 2 of 2"))
        shown.clear()
        os.write(keys, b"\x1b[D")
        job.until(lambda: sees("member 1 of 2"))
        os.write(keys, b"q")
        while job.running:
            sees("")  # so that the terminal has room for the last table
        assert job.wait().status == 0
        assert termios.tcgetattr(screen) == before
        flight.interrupt()
        assert flight.wait().status == 130
    finally:
        os.close(keys)
        os.close(screen)


def test_a_silent_domain_is_named(terminal: Terminal) -> None:
    done = terminal.run("watch", "--once", "--timeout", 0.1)
    assert done.status == 1
    domain = terminal.environment["ROS_DOMAIN_ID"]
    assert f"no flock found within 0.1 s on ROS domain {domain}" in done.error


def test_a_live_table_needs_a_terminal(terminal: Terminal) -> None:
    done = terminal.run("watch")
    assert (done.status, done.error) == (
        2,
        "error: a live table needs a terminal: add --once or --json",
    )
