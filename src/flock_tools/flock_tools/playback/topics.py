# SPDX-License-Identifier: Apache-2.0
"""Selects the topics of a bag that can be played, their types and their quality of service."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain
from typing import Any

from rclpy.exceptions import InvalidTopicNameException
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.validate_full_topic_name import validate_full_topic_name

from flock_sim.bag import limits
from flock_sim.bag.reading.reader import BagReader, Recorded, Stream
from flock_sim.errors import FlockError, nearest
from flock_sim.outside.yaml_text import parse_texts
from flock_tools.playback.message_types import installed_hash, message_class

DEFAULT_DEPTH = 10

DEEPEST = 100_000
"""Largest queue depth that is offered, in messages."""

MOST_TOPICS = 10_000
"""Largest number of topics that are played: each has a publisher."""

NUMBERS = {
    "history": {"1": "keep_last", "2": "keep_all"},
    "reliability": {"1": "reliable", "2": "best_effort"},
    "durability": {"1": "transient_local", "2": "volatile"},
}
"""The numbers in bags of ROS 2 before Jazzy, and the words that Jazzy writes instead."""

HISTORY = {"keep_all": HistoryPolicy.KEEP_ALL}
RELIABILITY = {"best_effort": ReliabilityPolicy.BEST_EFFORT}
DURABILITY = {"transient_local": DurabilityPolicy.TRANSIENT_LOCAL}
"""Policies that are not the default."""


OWN_TYPES = {"/parameter_events": "rcl_interfaces/msg/ParameterEvent"}
"""The topics of every node, on which its player can't publish messages of another type."""


@dataclass(frozen=True)
class Playable:
    """A topic that can be played: its message class and its quality of service."""

    type: Any
    qos: QoSProfile
    streams: tuple[Stream, ...] = ()
    """The streams of the bag with its messages."""
    publishers: int = 1
    """Number of recorded publishers, by their QoS profiles."""

    @property
    def latched(self) -> bool:
        """Whether late joiners receive the last messages."""
        return bool(self.qos.durability == DurabilityPolicy.TRANSIENT_LOCAL)


@dataclass(frozen=True)
class Selection:
    """The topics to play, by their expanded names.

    `skipped` gives, by name, the reason why other topics, or some channels of these, are left out.
    `notes` lists other changes from the recording.
    """

    topics: Mapping[str, Playable]
    skipped: Mapping[str, str]
    notes: Sequence[str] = ()
    played_as: Callable[[str], str] = lambda name: expanded(name)
    """Gives the name on which the messages of a recorded topic are played."""

    @property
    def streams(self) -> list[Stream]:
        """The streams of the bag that are read."""
        return [stream for topic in self.topics.values() for stream in topic.streams]

    def renamed(self, messages: Iterable[Recorded]) -> Iterator[Recorded]:
        """Yield messages with the names of the topics on which they are played."""
        return ((self.played_as(topic), stamp, data) for topic, stamp, data in messages)


@dataclass(frozen=True)
class Wishes:
    """The topics that the user names, as they were recorded, with or without the slash."""

    only: Sequence[str] | None = None
    """Topics to play; None: all."""
    without: Sequence[str] = ()
    remap: Sequence[str] = ()
    """Other names, as OLD:=NEW."""
    reserved: Mapping[str, str] = field(default_factory=dict)
    """Names on which no recorded topic is played, with the reason."""


EVERYTHING = Wishes()


def select(bag: BagReader, wishes: Wishes = EVERYTHING) -> Selection:
    """Return the topics of `bag` to play: those of `wishes` that can be played.

    Raises FlockError if a named topic is not in the bag, if one of those to play can't be played,
    or if no topic can.
    """
    recorded = {expanded(stream.topic) for stream in bag.streams}
    only = _known("--topics", wishes.only or sorted(recorded), recorded)
    without = _known("--exclude-topics", wishes.without, recorded)
    new_name = _remapped(wishes.remap, recorded)

    def played_as(name: str) -> str:
        return new_name.get(expanded(name), expanded(name))

    found: dict[str, list[Stream]] = {}
    for stream in bag.streams:
        if expanded(stream.topic) in only.keys() - without.keys():
            found.setdefault(played_as(stream.topic), []).append(stream)
    if wishes.only:
        found = {name: found[name] for name in map(played_as, only) if name in found}
    if len(found) > MOST_TOPICS:
        what = limits.beyond(len(found), MOST_TOPICS, "topics")
        raise FlockError(f"{bag.path} has {what}: choose some by --topics")
    topics: dict[str, Playable] = {}
    skipped = {name: reason for name, reason in wishes.reserved.items() if name in found}
    notes: list[str] = []
    for name in [name for name in found if name not in skipped]:
        topic, reasons = _playable(bag, name, found[name])
        if reasons:
            skipped[name] = "; ".join(reasons)
        if topic is not None:
            topics[name] = topic
            if topic.qos.depth > DEEPEST:
                notes.append(
                    f"{name}: its queue depth of {topic.qos.depth} is reduced to {DEEPEST}"
                )
                topic.qos.depth = DEEPEST
        elif wishes.only:
            raise FlockError(f"--topics {name}: {skipped[name]}")
    if not topics:
        reasons = [f"{name}: {reason}" for name, reason in skipped.items()]
        raise FlockError(
            f"{bag.path}: none of its topics can be played ({'; '.join(reasons) or 'it has none'})"
        )
    return Selection(topics, skipped, notes, played_as)


def _known(option: str, names: Iterable[str], recorded: Collection[str]) -> dict[str, None]:
    """Return expanded `names` in order. Raises FlockError if one is not `recorded`."""
    for name in names:
        if expanded(name) not in recorded:
            raise FlockError(f"{option} {name}: {nearest(name, sorted(recorded))}")
    return dict.fromkeys(map(expanded, names))


def _remapped(rules: Iterable[str], recorded: Collection[str]) -> dict[str, str]:
    """Return the new name of each recorded topic in `rules`. Raises FlockError if one is wrong."""
    found: dict[str, str] = {}
    for rule in rules:
        old, between, new = rule.partition(":=")
        try:
            validate_full_topic_name(expanded(new))
        except InvalidTopicNameException:
            between = ""
        if not between:
            raise FlockError(
                f"--remap {rule}: must be OLD:=NEW, a recorded topic and a name that ROS 2 allows"
            )
        (name,) = _known("--remap", [old], recorded)
        if found.setdefault(name, expanded(new)) != expanded(new):
            raise FlockError(f"--remap {rule}: {name} is already played as {found[name]}")
    return found


def expanded(name: str) -> str:
    """Return a recorded name as ROS 2 expands it in a node without a namespace."""
    return name if name.startswith(("/", "~")) else f"/{name}"


def recorded_profiles(text: str) -> list[QoSProfile]:
    """Return the profiles that publishers offered, as rosbag2 writes them in a channel's metadata.

    Deadline, lifespan and liveliness are left out. A text that can't be read has no profiles.
    """
    if len(text) > limits.LARGEST_PROFILES:
        return []
    try:
        return [_profile(entry) for entry in parse_texts(text) or ()]
    except (FlockError, TypeError, AttributeError, ValueError):
        return []


def merged(profiles: Sequence[QoSProfile]) -> QoSProfile:
    """Return the profile to play with: of equal durability and reliability, the deepest queue.

    If these differ, or without profiles, it is reliable, volatile, keep-last 10.
    """
    kinds = {(profile.durability, profile.reliability) for profile in profiles}
    if len(kinds) != 1:
        return QoSProfile(depth=DEFAULT_DEPTH)
    return max(profiles, key=lambda each: (each.history == HistoryPolicy.KEEP_ALL, each.depth))


def _profile(entry: Mapping[str, Any]) -> QoSProfile:
    def word(key: str) -> str:
        said = str(entry.get(key))
        return NUMBERS[key].get(said, said)

    history, reliability, durability = word("history"), word("reliability"), word("durability")
    return QoSProfile(
        history=HISTORY.get(history, HistoryPolicy.KEEP_LAST),
        depth=max(1, int(entry.get("depth") or DEFAULT_DEPTH)),
        reliability=RELIABILITY.get(reliability, ReliabilityPolicy.RELIABLE),
        durability=DURABILITY.get(durability, DurabilityPolicy.VOLATILE),
    )


def _playable(
    bag: BagReader, name: str, streams: Sequence[Stream]
) -> tuple[Playable | None, list[str]]:
    """Return the playable part of topic `name`, of one type, and why other streams are not."""
    chosen: list[Stream] = []
    kind: Any = None
    reasons: list[str] = []
    for stream in streams:
        try:
            its_kind = _class_of(bag, name, stream)
        except ValueError as error:
            reasons.append(str(error))
            continue
        if kind is None or its_kind is kind:
            kind = its_kind
            chosen.append(stream)
        else:
            reasons.append(f"its messages of type {stream.type}, since {chosen[0].type} is played")
    if kind is None:
        return None, list(dict.fromkeys(reasons))
    told = {
        channel.metadata.get("offered_qos_profiles", "")
        for stream in chosen
        for channel in bag.streams[stream]
    }
    profiles = [recorded_profiles(text) for text in told]
    publishers = max(1, *map(len, profiles))
    playable = Playable(kind, merged([*chain(*profiles)]), tuple(chosen), publishers)
    return playable, list(dict.fromkeys(reasons))


def _class_of(bag: BagReader, name: str, stream: Stream) -> Any:
    """Return the message class. Raises ValueError, with the reason, if it can't be played."""
    if stream.encoding != "cdr":
        raise ValueError(f"its messages are encoded as {stream.encoding!r}, not as cdr")
    try:
        validate_full_topic_name(name)
    except InvalidTopicNameException as error:
        raise ValueError("ROS 2 does not allow its name") from error
    if not stream.type:
        raise ValueError("it has no schema, so the type of its messages is unknown")
    if stream.type != (own := OWN_TYPES.get(name, stream.type)):
        raise ValueError(f"its type {stream.type} is not {own}, which each node publishes there")
    kind = message_class(stream.type)
    _check_definition(stream, [channel.metadata for channel in bag.streams[stream]])
    return kind


def _check_definition(stream: Stream, metadata: Iterable[Mapping[str, str]]) -> None:
    """Raise ValueError if the recorded definition is not the installed one."""
    recorded = {entry["topic_type_hash"] for entry in metadata if entry.get("topic_type_hash")}
    if recorded and (installed := installed_hash(stream.type)) and recorded != {installed}:
        raise ValueError(
            f"its type {stream.type} is installed with another definition than in the bag"
        )
