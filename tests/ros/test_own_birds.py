# SPDX-License-Identifier: Apache-2.0
"""Birds of the user's own program beside Flock's nodes: the bag of any recorder names them."""

from __future__ import annotations

import sys
from pathlib import Path

from flock_interfaces import srv
from flock_sim.nodes.bird import BirdNode
from flock_sim.nodes.own_birds import own_name
from flock_sim.protocol.bird import BirdProtocol
from flock_sim.protocol.free_bird import FreeBird
from flock_sim.recording.own_parts import BIRD, OwnPart
from flock_sim.recording.run import Run
from support.terminal import Job, Terminal
from support.visitor import Visitor

OWN_NODE = """
import sys

from flock_sim import BirdNode
from flock_sim.nodes import bird_process


class Keeper_(BirdNode):
    pass


bird_process.BirdNode = Keeper_
sys.exit(bird_process.main())
"""

FLOCK = ("birds:=2", "t_max:=200.0")


def start(terminal: Terminal, tool: str, *given: str) -> Job:
    words = [word for parameter in (*given, *FLOCK) for word in ("-p", parameter)]
    return terminal.start(tool, "--ros-args", *words)


def own_bird(terminal: Terminal, index: int) -> Job:
    """Start bird `index` by a program of the user."""
    script = terminal.directory / "keeper.py"
    script.write_text(OWN_NODE, encoding="utf-8")
    words = [word for parameter in (f"index:={index}", *FLOCK) for word in ("-p", parameter)]
    return terminal.start_command("keeper", [sys.executable, script, "--ros-args", *words])


def own_parts(bag: Path) -> list[OwnPart]:
    with Run(bag) as run:
        return run.own_parts


def test_the_bag_of_a_recorder_by_hand_names_an_own_bird_and_so_does_that_of_its_playback(
    terminal: Terminal, visitor: Visitor
) -> None:
    nodes = [
        start(terminal, "clock"),
        start(terminal, "recorder", "output:=bag"),
        start(terminal, "bird", "index:=1"),
        own_bird(terminal, 2),
    ]
    for node in nodes:
        done = node.wait()
        assert done.status == 0, done.stderr
    keeper = [OwnPart(BIRD, "Keeper_")]
    assert own_parts(terminal.directory / "bag") == keeper
    done = terminal.run("reference", "--repeat", "bag", "--output", "again")
    assert done.status == 2
    assert "flown by birds of Keeper_, which are not in Flock" in done.error
    player = terminal.start("play", "bag", "--rate", 0, "--paused")
    recorder = start(terminal, "recorder", "output:=again", "played:=true")
    recorder.until_said("the topics of all birds and /clock are found")
    visitor.ask(srv.Resume, "/flock/player/resume")
    visitor.until(lambda: not recorder.running)
    assert (recorder.wait().status, player.wait().status) == (0, 0)
    assert own_parts(terminal.directory / "again") == keeper


def test_a_flight_of_birds_of_flock_names_none(terminal: Terminal) -> None:
    terminal.well("fly", "--birds", 2, "--t-max", 50, "--processes", 2, "--output", "bag")
    assert own_parts(terminal.directory / "bag") == []


def test_what_is_not_flocks_has_a_name() -> None:
    class Own(BirdNode):
        pass

    class OwnProtocol(FreeBird):
        pass

    node, protocol = BirdNode.__new__(BirdNode), BirdProtocol.__new__(BirdProtocol)
    assert own_name(node, protocol) == ""
    assert own_name(Own.__new__(Own), protocol) == "Own"
    assert own_name(node, OwnProtocol.__new__(OwnProtocol)) == "OwnProtocol"
