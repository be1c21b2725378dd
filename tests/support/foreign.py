# SPDX-License-Identifier: Apache-2.0
"""Bags that other programs write, such as rosbag2 and plain MCAP writers."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import yaml
import zstandard
from mcap.writer import CompressionType, Writer

SECOND = 10**9
STRING = "std_msgs/msg/String"
FOREVER = {"sec": 9223372036, "nsec": 854775807}


def word(text: str) -> bytes:
    """Return a String as CDR."""
    data = text.encode() + b"\0"
    return b"\x00\x01\x00\x00" + struct.pack("<I", len(data)) + data


def profile(depth: int = 10, durability: str = "volatile", history: str = "keep_last") -> str:
    """Return an offered QoS profile as rosbag2 writes it. Several texts can be joined."""
    offered = {
        "history": history,
        "depth": depth,
        "reliability": "reliable",
        "durability": durability,
        "deadline": dict(FOREVER),
        "lifespan": dict(FOREVER),
        "liveliness": "automatic",
        "liveliness_lease_duration": dict(FOREVER),
        "avoid_ros_namespace_conventions": False,
    }
    return yaml.safe_dump([offered], sort_keys=False)


@dataclass(frozen=True)
class Channel:
    """A channel of an MCAP file. Without a type it has no schema."""

    topic: str
    type: str = STRING
    encoding: str = "cdr"
    profiles: str = profile()
    type_hash: str = ""


Message = tuple[Channel, float, bytes]
"""Channel, log time in s, data."""


def write_file(
    path: Path,
    messages: Sequence[Message],
    *,
    chunk: int = 1 << 20,
    record: Mapping[str, str] | None = None,
) -> Path:
    """Write one MCAP file. With a `chunk` of 0 bytes, every message has a chunk of its own.

    `record` is rosbag2's metadata record; None: the file has none.
    """
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=chunk, compression=CompressionType.NONE)
        writer.start(profile="ros2", library="a test")
        if record is not None:
            writer.add_metadata("rosbag2", dict(record))
        schemas: dict[str, int] = {"": 0}
        channels: dict[Channel, int] = {}
        for channel in dict.fromkeys(map(_key, messages)):
            if channel.type not in schemas:
                schemas[channel.type] = writer.register_schema(
                    channel.type, "ros2msg", b"string data\n"
                )
            channels[channel] = writer.register_channel(
                channel.topic,
                channel.encoding,
                schemas[channel.type],
                {
                    "offered_qos_profiles": channel.profiles,
                    "topic_type_hash": channel.type_hash,
                },
            )
        for channel, time, data in messages:
            stamp = round(time * SECOND)
            writer.add_message(channels[channel], stamp, data, stamp)
        writer.finish()
    return path


def _key(message: Message) -> Channel:
    return message[0]


def write_bag(
    directory: Path,
    *files: Sequence[Message],
    mode: str = "",
    listed: Sequence[str] | None = None,
    chunk: int = 1 << 20,
) -> Path:
    """Write a bag of one MCAP file for each of `files`. `mode` is rosbag2's compression mode.

    `listed` are the files that metadata.yaml lists; None: all files.
    """
    directory.mkdir(parents=True)
    names = []
    for number, messages in enumerate(files):
        if mode == "MESSAGE":
            messages = [(each, time, zstandard.compress(data)) for each, time, data in messages]
        path = write_file(directory / f"{directory.name}_{number}.mcap", messages, chunk=chunk)
        if mode == "FILE":
            packed = path.with_name(f"{path.name}.zstd")
            packed.write_bytes(zstandard.compress(path.read_bytes()))
            path.unlink()
            path = packed
        names.append(path.name)
    write_metadata(directory, names if listed is None else listed, mode)
    return directory


def write_metadata(directory: Path, listed: Sequence[str], mode: str = "") -> None:
    """Write metadata.yaml, with only the keys that this project reads."""
    information = {
        "version": 9,
        "storage_identifier": "mcap",
        "topics_with_message_count": [
            {"topic_metadata": {"name": "/a", "offered_qos_profiles": profile()}}
        ],
        "compression_format": "zstd" if mode else "",
        "compression_mode": mode,
        "relative_file_paths": list(listed),
    }
    text = yaml.safe_dump({"rosbag2_bagfile_information": information}, sort_keys=False)
    (directory / "metadata.yaml").write_text(text, encoding="utf-8")
