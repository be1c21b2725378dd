# SPDX-License-Identifier: Apache-2.0
"""A bare relay: the nodes, topics and messages of a flight, and nothing else.

Its nodes send as many stage messages to the same neighbours as birds do, each as soon as it has its
neighbours' last ones, without physics, protocol, clock or recorder: what the exchange costs.
Prints the monotonic times at which its first and its last node began and ended.

    relay.py events|direct BIRDS STEPS FIRST LAST
"""

from __future__ import annotations

import os
import sys
import time

import numpy as np

from flock_interfaces.msg import BirdStage
from flock_sim.messages import topics
from flock_sim.messages import types as messages
from flock_sim.physics import formation
from flock_sim.ros.discovery import prepare_discovery
from flock_sim.ros.endpoints import DrainedNode, latched
from flock_sim.ros.process import executing, ros_context

ONE = np.ones(1)


class RelayNode(DrainedNode):
    """One bird that only passes on."""

    def __init__(self, bird: int, birds: int, ticks: int, direct: bool, context: object) -> None:
        super().__init__(
            topics.bird_name(bird),
            namespace="/relay",
            context=context,
            start_parameter_services=False,
            enable_rosout=False,
        )
        self.tick = 0
        self.ticks = ticks
        self.begun = self.ended = 0.0
        self.heard = dict.fromkeys(formation.neighbours(bird, birds, "nearest"), 0)
        self.data = messages.Stage(1, 0, 1, bird, 0, ONE, ONE, ONE).encode()
        self.outlet = self.create_publisher(
            BirdStage, f"/relay/{topics.bird_name(bird)}/stage", latched(topics.STAGE_DEPTH)
        )
        self.inlets = {}
        for other in self.heard:
            topic = f"/relay/{topics.bird_name(other)}/stage"
            if direct:
                self.inlets[other] = self.subscribe_drained(BirdStage, topic)
            else:
                self.create_subscription(
                    BirdStage,
                    topic,
                    lambda data, other=other: self.hear(other),
                    latched(topics.STAGE_DEPTH),
                    raw=True,
                )

    def send(self) -> None:
        """Send the message of this tick."""
        self.outlet.publish(self.data)

    def hear(self, other: int) -> None:
        """Count a message of `other`; send as many as that allows."""
        self.heard[other] += 1
        while self.tick < self.ticks and min(self.heard.values()) > self.tick:
            self.begun = self.begun or time.monotonic()
            self.tick += 1
            self.ended = time.monotonic()
            self.send()

    def drain(self) -> bool:
        """Take what this tick still lacks, straight from the subscriptions."""
        moved = False
        for other, inlet in self.inlets.items():
            if self.heard[other] <= self.tick and inlet.take() is not None:
                moved = True
                self.hear(other)
        return moved


def main() -> None:
    """Relay with the birds FIRST..LAST in this process."""
    kind = sys.argv[1]
    birds, steps, first, last = (int(word) for word in sys.argv[2:])
    prepare_discovery()
    context = ros_context()
    with executing("events", context) as executor:
        nodes = [
            RelayNode(bird, birds, 4 * steps, kind == "direct", context)
            for bird in range(first, last + 1)
        ]
        for node in nodes:
            executor.add_node(node)
            node.send()
        while any(node.tick < node.ticks for node in nodes):
            if kind == "events":
                executor.spin_once(timeout_sec=1.0)
            else:
                moved = [node.drain() for node in nodes]
                if not any(moved):
                    os.sched_yield()
        for node in nodes:
            node.outlet.wait_for_all_acked()
        print(min(node.begun for node in nodes), max(node.ended for node in nodes))
    context.try_shutdown()


if __name__ == "__main__":
    main()
