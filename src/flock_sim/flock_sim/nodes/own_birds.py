# SPDX-License-Identifier: Apache-2.0
"""Birds of the user's own program among the birds of a process."""

from __future__ import annotations

from collections.abc import Iterable

from flock_sim.nodes.bird import BirdNode
from flock_sim.nodes.free_bird import FreeBirdNode
from flock_sim.protocol.bird import BirdProtocol
from flock_sim.protocol.free_bird import FreeBird
from flock_sim.recording.own_parts import BIRD, OwnPart


def own_birds(birds: Iterable[BirdNode]) -> list[OwnPart]:
    """Return the classes of `birds` that are not Flock's, each once.

    For a node of Flock's with an own protocol or control, this is the name of the protocol's class
    or of the control.
    """
    named = (own_name(bird) for bird in birds)
    return [OwnPart(BIRD, name) for name in dict.fromkeys(named) if name]


def own_name(bird: BirdNode) -> str:
    """Return the name of the own part of `bird`; empty if all of it is Flock's."""
    protocol = bird.protocol
    if type(bird) not in (BirdNode, FreeBirdNode):
        return type(bird).__name__
    if type(protocol) not in (BirdProtocol, FreeBird):
        return type(protocol).__name__
    control = protocol.control if isinstance(protocol, BirdProtocol) else None
    return getattr(control, "__name__", type(control).__name__) if control else ""
