# SPDX-License-Identifier: Apache-2.0
"""Which topics of a bag can be played here, as what, and with what quality of service."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import yaml
from rclpy.exceptions import InvalidTopicNameException
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.type_support import NoTypeSupportImportedException, check_for_type_support
from rclpy.validate_full_topic_name import validate_full_topic_name

from flock_sim.bag.reader import BagReader
from flock_sim.core.spelling import nearest
from flock_sim.errors import FlockError

DEFAULT_DEPTH = 10
NUMBERS = {
    "history": {1: "keep_last", 2: "keep_all"},
    "reliability": {1: "reliable", 2: "best_effort"},
    "durability": {1: "transient_local", 2: "volatile"},
}
"""How bags of ROS 2 before Jazzy write what Jazzy writes in words."""

HISTORY = {"keep_all": HistoryPolicy.KEEP_ALL}
RELIABILITY = {"best_effort": ReliabilityPolicy.BEST_EFFORT}
DURABILITY = {"transient_local": DurabilityPolicy.TRANSIENT_LOCAL}
"""What is not the default."""


@dataclass(frozen=True)
class Playable:
    """A topic that can be played: the class of its messages, and how they are offered."""

    type: Any
    qos: QoSProfile


@dataclass(frozen=True)
class Selection:
    """The topics to play, by name, and why others are left out, by name."""

    topics: Mapping[str, Playable]
    skipped: Mapping[str, str]


def select(bag: BagReader, wanted: Sequence[str] | None) -> Selection:
    """Return what of `bag` is to be played: all that can be, or the topics `wanted`.

    Raises FlockError where one of these is not in the bag or can't be played, or none can.
    """
    for name in wanted or ():
        if name not in bag.topics:
            raise FlockError(f"--topics {name}: {nearest(name, sorted(bag.topics))}")
    topics: dict[str, Playable] = {}
    skipped: dict[str, str] = {}
    for name in dict.fromkeys(wanted or bag.topics):
        try:
            topics[name] = _playable(bag, name)
        except ValueError as error:
            if wanted:
                raise FlockError(f"--topics {name}: {error}") from error
            skipped[name] = str(error)
    if not topics:
        reasons = "; ".join(f"{name}: {reason}" for name, reason in skipped.items())
        raise FlockError(f"{bag.path}: no topic of it can be played ({reasons or 'it has none'})")
    return Selection(topics, skipped)


def recorded_qos(text: str) -> QoSProfile:
    """Return the profile that publishers offered, as rosbag2 writes it in a channel's metadata.

    Where several offered different ones, or nothing is said that can be read: reliable, volatile,
    the last 10. Deadlines, life spans and liveliness are left out.
    """
    try:
        profiles = [_profile(entry) for entry in yaml.safe_load(text) or ()]
    except (yaml.YAMLError, TypeError, AttributeError, ValueError):
        profiles = []
    if profiles and all(profile == profiles[0] for profile in profiles):
        return profiles[0]
    return QoSProfile(depth=DEFAULT_DEPTH)


def _profile(entry: Mapping[str, Any]) -> QoSProfile:
    def word(key: str) -> str:
        said = entry.get(key)
        return str(NUMBERS[key].get(said, said) if isinstance(said, int) else said)

    history, reliability, durability = word("history"), word("reliability"), word("durability")
    return QoSProfile(
        history=HISTORY.get(history, HistoryPolicy.KEEP_LAST),
        depth=max(1, int(entry.get("depth") or DEFAULT_DEPTH)),
        reliability=RELIABILITY.get(reliability, ReliabilityPolicy.RELIABLE),
        durability=DURABILITY.get(durability, DurabilityPolicy.VOLATILE),
    )


def _playable(bag: BagReader, name: str) -> Playable:
    """Raises ValueError, with the reason, where topic `name` can't be played."""
    channel = bag.channels[name]
    if channel.message_encoding != "cdr":
        raise ValueError(f"its messages are encoded as {channel.message_encoding!r}, not as cdr")
    try:
        validate_full_topic_name(name)
    except InvalidTopicNameException as error:
        raise ValueError("its name is none that ROS 2 allows") from error
    kind = _message_class(bag.topics[name])
    return Playable(kind, recorded_qos(channel.metadata.get("offered_qos_profiles", "")))


def _message_class(name: str) -> Any:
    """Return the class of the message type `name`; raises ValueError where there is none here."""
    package, _, rest = name.partition("/")
    try:
        kind = getattr(import_module(f"{package}.msg"), rest.rpartition("/")[2])
        check_for_type_support(kind)
    except (ImportError, AttributeError, ValueError, NoTypeSupportImportedException) as error:
        raise ValueError(f"its type {name} can't be imported here") from error
    return kind
