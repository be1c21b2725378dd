# SPDX-License-Identifier: Apache-2.0
"""A listener takes as the flock what is published, whatever else is on its domain."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TypeVar

import numpy as np
import pytest
from rclpy.context import Context
from rclpy.executors import Executor
from rclpy.node import Node

from flock_interfaces.msg import BirdState
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.messages import topics
from flock_sim.messages.types import State
from flock_sim.ros.endpoints import latched
from flock_sim.ros.process import executing
from flock_tools.live.flock_monitor import Sample
from flock_tools.live.listener import DEPTH, Watcher

FLOCK = FlockConfiguration(birds=3, t_max=100.0)
DEADLINE = 60.0

Kind = TypeVar("Kind", bound=Node)


class Domain:
    """Nodes on one domain, and a listener among them."""

    def __init__(self, context: Context, executor: Executor) -> None:
        self.context, self.executor = context, executor
        self.watcher = self.add(Watcher(context))

    def add(self, node: Kind) -> Kind:
        self.executor.add_node(node)
        return node

    def node(self, name: str) -> Node:
        return self.add(Node(name, namespace=topics.NAMESPACE, context=self.context))

    def play(self, node: Node, birds: int, step: int = 0) -> None:
        """Publish a recorded step of a flock from `node`."""
        for bird in range(1, birds + 1):
            outlet = node.create_publisher(BirdState, topics.state_topic(bird), latched(DEPTH))
            outlet.publish(State.at(FLOCK, step, *np.ones((6, 1))).encode())

    def sample(self) -> Sample | None:
        return self.watcher.view.sample(self.watcher.birds, 1)

    def until(self, condition: Callable[[], bool]) -> None:
        deadline = time.monotonic() + DEADLINE
        while not condition():
            assert time.monotonic() < deadline, (self.watcher.birds, self.sample())
            self.executor.spin_once(timeout_sec=0.05)


@contextmanager
def _domain(context: Context) -> Iterator[Domain]:
    with executing("single", context) as executor:
        yield Domain(context, executor)


@pytest.fixture
def domain(context: Context) -> Iterator[Domain]:
    with _domain(context) as made:
        yield made


def test_a_topic_without_a_publisher_is_of_no_bird(domain: Domain) -> None:
    other = domain.node("other_watch")
    for bird in (2, 9):
        other.create_subscription(
            BirdState, topics.state_topic(bird), lambda _: None, latched(1), raw=True
        )
    domain.play(domain.node("player"), birds=3)
    domain.until(lambda: domain.sample() is not None)
    assert domain.watcher.birds == {1, 2, 3}


def test_the_age_of_a_state_counts_from_when_it_was_sent(domain: Domain) -> None:
    domain.play(domain.node("player"), birds=3)
    sent = time.monotonic()
    time.sleep(1.0)  # nobody takes the states meanwhile
    domain.until(lambda: domain.sample() is not None)
    shown = domain.sample()
    assert shown is not None
    # An age since the states were taken would be near 0. The bounds leave room for a suspension of
    # this process between its looks at two clocks.
    assert min(shown.age) > 0.5
    assert max(shown.age) < time.monotonic() - sent + 0.5


def test_a_flock_is_shown_after_its_end(domain: Domain) -> None:
    player = domain.node("player")
    domain.play(player, birds=3)
    domain.until(lambda: domain.sample() is not None)
    domain.executor.remove_node(player)
    player.destroy_node()
    domain.until(lambda: not domain.watcher.count_publishers(topics.state_topic(1)))
    domain.watcher.look_around()
    shown = domain.sample()
    assert shown is not None
    assert shown.birds == 3
