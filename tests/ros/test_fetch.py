# SPDX-License-Identifier: Apache-2.0
"""Listeners fetch states, many at a time. The list of nodes is sent, so that it is never late."""

from __future__ import annotations

import re
import sys
import time
from pathlib import Path
from subprocess import PIPE, Popen

import pytest
from rosgraph_msgs.msg import Clock

from flock_sim.ros import discovery, fetch
from flock_sim.ros.fetch import let_fetch
from support.terminal import Terminal
from support.visitor import Visitor

TALKER = """
import sys
import rclpy
from rosgraph_msgs.msg import Clock
from flock_sim.ros.discovery import prepare_discovery
from flock_sim.ros.endpoints import DrainedNode, latched
from flock_sim.ros.fetch import let_fetch
from flock_sim.ros.log import ros_context

prepare_discovery()
context = ros_context()
node = DrainedNode("talker", context=context, start_parameter_services=False, enable_rosout=False)
assert let_fetch(["/fetched"], float(sys.argv[1]))
assert let_fetch(["/fetched"], float(sys.argv[1]))
outlets = {
    name: node.create_publisher(Clock, name, latched(1000)) for name in ("/fetched", "/sent")
}
message = Clock()
more = []
for line in sys.stdin:
    what, name, count = line.split()
    if what == "make":
        more.append(DrainedNode(name, context=context))
    for _ in range(int(count)):
        message.clock.sec += 1
        outlets[name].publish(message)
    print("done", flush=True)
for each in (node, *more):
    each.destroy_node()
rclpy.try_shutdown(context=context)
"""


class Talker:
    """Another process, which publishes what it is told to."""

    def __init__(self, terminal: Terminal, period: float) -> None:
        self._process = Popen(
            [sys.executable, "-c", TALKER, str(period)],
            stdin=PIPE,
            stdout=PIPE,
            text=True,
            env=dict(terminal.environment),
        )

    def say(self, topic: str, count: int) -> None:
        """Have it publish so many messages, and wait until it has."""
        self._do(f"publish {topic} {count}")

    def make(self, node: str) -> None:
        """Have it make another node, and wait until it has."""
        self._do(f"make {node} 0")

    def _do(self, what: str) -> None:
        assert self._process.stdin
        assert self._process.stdout
        self._process.stdin.write(f"{what}\n")
        self._process.stdin.flush()
        assert self._process.stdout.readline() == "done\n"

    @property
    def wake_ups(self) -> int:
        """How often the thread for the timers of Fast DDS has waited so far."""
        tasks = Path(f"/proc/{self._process.pid}/task").iterdir()
        (timers,) = (task for task in tasks if (task / "comm").read_text().startswith("dds.ev."))
        status = (timers / "status").read_text()
        found = re.search(r"^voluntary_ctxt_switches:\s+(\d+)$", status, re.MULTILINE)
        assert found
        return int(found[1])

    def end(self) -> int:
        """Have it end; return its exit status."""
        self._process.communicate()
        return self._process.returncode


def test_what_is_fetched_comes_whole_and_in_order(terminal: Terminal, visitor: Visitor) -> None:
    heard = visitor.hear(Clock, "/fetched", depth=1000)
    talker = Talker(terminal, 0.02)
    for _ in range(5):
        talker.say("/fetched", 100)
    visitor.until(lambda: len(heard) >= 500)
    assert [message.clock.sec for message in heard] == list(range(1, 501))
    assert talker.end() == 0


def test_what_is_fetched_is_not_sent_as_soon_as_it_is_published(
    terminal: Terminal, visitor: Visitor
) -> None:
    talker = Talker(terminal, 3600.0)
    # A listener that is found is told of earlier messages at once, and of later ones in an hour.
    talker.say("/fetched", 1)
    talker.say("/sent", 1)
    fetched = visitor.hear(Clock, "/fetched")
    sent = visitor.hear(Clock, "/sent")
    visitor.until(lambda: fetched and sent)  # all have found each other
    talker.say("/fetched", 10)
    talker.say("/sent", 10)
    order: list[int] = []

    def all_sent() -> bool:
        order.append(len(fetched))
        return len(sent) == 11

    visitor.until(all_sent)
    assert order[-1] == 1, "published before those that were sent, and never told of"
    assert talker.end() == 0


def test_fetched_messages_carry_no_announcements(terminal: Terminal, visitor: Visitor) -> None:
    """Fast DDS adds one to each message once the queue of the publisher is full, by default.

    A request of DDS names up to 256 messages. The next announcement, of those after them, comes in
    an hour.
    """
    talker = Talker(terminal, 3600.0)
    talker.say("/fetched", 1200)  # the queue has room for 1000
    talker.say("/sent", 1)
    fetched = visitor.hear(Clock, "/fetched", depth=1000)
    sent = visitor.hear(Clock, "/sent", depth=1000)
    visitor.until(lambda: len(fetched) >= 256 and sent)
    for k in range(2, 102):
        talker.say("/sent", 1)
        visitor.until(lambda k=k: len(sent) == k)
    assert [message.clock.sec for message in fetched] == list(range(201, 457))
    assert talker.end() == 0


def test_sending_messages_does_not_wake_the_timers_each_time(
    terminal: Terminal, visitor: Visitor
) -> None:
    talker = Talker(terminal, 0.02)
    sent = visitor.hear(Clock, "/sent", depth=1000)
    talker.say("/sent", 1)
    visitor.until(lambda: sent)
    before, begun = talker.wake_ups, time.monotonic()
    for k in range(20):
        talker.say("/sent", 100)
        visitor.until(lambda k=k: len(sent) > 100 * (k + 1))
    # A publisher starts a timer of 10 ms and one of 20 ms. Others run at 1 to 10 times per second.
    assert talker.wake_ups - before < 100 + 250 * (time.monotonic() - begun)
    assert talker.end() == 0


def test_nodes_that_are_made_long_after_discovery_are_known_by_name(
    terminal: Terminal, visitor: Visitor
) -> None:
    talker = Talker(terminal, 0.02)
    visitor.until(lambda: "talker" in visitor.node.get_node_names())
    for k in range(3):
        time.sleep(0.5)  # Fast DDS has announced all that there is, and is at rest
        talker.make(f"node_{k}")
        visitor.until(lambda k=k: f"node_{k}" in visitor.node.get_node_names())
    assert talker.end() == 0


@pytest.mark.parametrize("why", ["period", "settings", "library"])
def test_topics_are_left_as_they_are_where_fast_dds_is_not_ours(
    visitor: Visitor, monkeypatch: pytest.MonkeyPatch, why: str
) -> None:
    if why == "settings":
        monkeypatch.setenv(discovery.PROFILES[0], "/somebody/else.xml")
    if why == "library":
        monkeypatch.setattr(fetch, "fast_dds", lambda: None)
    assert not let_fetch([f"/not_fetched_{why}"], 0.0 if why == "period" else 0.02)
