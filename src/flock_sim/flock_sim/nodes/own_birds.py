# SPDX-License-Identifier: Apache-2.0
"""Birds of the user's own program: a recorder, in any process, learns that they fly.

A node whose class or protocol is not Flock's creates a publisher on a topic whose name ends with
the name of that class. The topic has no messages. The node creates it before
its other topics, so a recorder that has discovered these has discovered it, too. A player does the
same for the own birds that are named in the bag.
"""

from __future__ import annotations

import re

from rclpy.node import Node

from flock_interfaces.msg import BirdWing
from flock_sim.messages.topics import NAMESPACE
from flock_sim.recording.own_parts import BIRD, OwnPart
from flock_sim.ros.endpoints import FlockNode, latched

_FOLDER = f"{NAMESPACE}/own"

_LONGEST = 100  # characters of a name: the length of a topic's name is limited


def own_name(node: object, protocol: object) -> str:
    """Return the name of the class of a bird's node or protocol that is not Flock's, or ""."""
    for part in (node, protocol):
        if not type(part).__module__.startswith("flock_sim."):
            return type(part).__name__
    return ""


def announce(node: Node, name: str) -> None:
    """Tell all recorders that birds of the own class `name` fly, as `node`.

    A topic's name can't have all characters: those of other alphabets become underscores.
    """
    token = re.sub(r"\W|^(?=\d|$)", "_", name, flags=re.ASCII)[:_LONGEST]
    node.create_publisher(BirdWing, f"{_FOLDER}/{token}", latched(1))


def announced(node: FlockNode) -> list[OwnPart]:
    """Return the own birds that `node` has discovered."""
    names = sorted(name for name, _ in node.get_topic_names_and_types())
    prefix = f"{node.own_topic(_FOLDER)}/"
    found = [name for name in names if name.startswith(prefix) and node.count_publishers(name)]
    return [OwnPart(BIRD, name.removeprefix(prefix)) for name in found]
