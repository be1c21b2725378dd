# SPDX-License-Identifier: Apache-2.0
"""A bag is a rosbag2 bag: `rosbags` reads its metadata and every message."""

from pathlib import Path

import numpy as np
import yaml
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from flock_sim.bag.definitions import Definition, installed_definition
from flock_sim.bag.reading.reader import BagReader
from flock_sim.bag.topic import Topic
from flock_sim.bag.writing.writer import BagWriter

STATE = "flock_interfaces/msg/BirdState"
TOPICS = [
    Topic("/flock/bird_01/state", STATE),
    Topic("/flock/bird_02/state", STATE, depth=0, history="keep_all"),
    Topic("/clock", "rosgraph_msgs/msg/Clock", reliability="best_effort", depth=1),
    Topic("/flock/bird_01/wing", "flock_interfaces/msg/BirdWing", durability="transient_local"),
]
METADATA = {"flock": {"birds": "2", "note": "Gänse 🪿 «∞»", "empty": ""}, "run": {}}


def payloads(count: int) -> list[tuple[str, int, bytes]]:
    """Topic, log time and data of `count` messages; every length modulo 8 is met."""
    return [
        (TOPICS[i % 3].name, 1_000 + 7 * i, bytes((i * k) % 251 for k in range(20 + i % 50)))
        for i in range(count)
    ]


def write_bag(directory: Path, messages: list[tuple[str, int, bytes]], **options: int) -> Path:
    with BagWriter(directory, TOPICS, METADATA, **options) as bag:
        for topic, time, data in messages:
            bag.write(topic, time, data)
    return directory / f"{directory.name}_0.mcap"


def test_rosbags_deserialises_every_message_by_the_embedded_definitions(tmp_path: Path) -> None:
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(installed_definition(STATE).text, STATE))
    state_type, types = store.types[STATE], store.types
    header = types["std_msgs/msg/Header"]
    stamp = types["builtin_interfaces/msg/Time"]

    sent = []
    with BagWriter(tmp_path / "bag", TOPICS, METADATA, chunk_size=4_096) as bag:
        for step in range(200):
            members = np.array([step / 3, -0.0, np.nan])
            state = state_type(
                header=header(stamp=stamp(sec=step, nanosec=7), frame_id="flock"),
                step=step,
                time=step / 7,
                position=members,
                speed=members + 1,
                circulation=members[:0],
                interaction_drag=members * 2,
                mean_speed=members * 3,
                mean_interaction_drag=members[:1],
                forcing_state=members[:2],
                run_id=0,
                epoch=0,
            )
            cdr = bytes(store.serialize_cdr(state, STATE))
            bag.write(step % 2, step * 10**9, cdr)
            sent.append(cdr)
    with AnyReader([tmp_path / "bag"]) as reader:
        assert reader.message_count == 200
        assert reader.start_time == 0
        assert reader.duration == 199 * 10**9 + 1  # rosbags counts the last nanosecond in
        assert {c.topic: c.msgcount for c in reader.connections} == {
            TOPICS[0].name: 100,
            TOPICS[1].name: 100,
            TOPICS[2].name: 0,
            TOPICS[3].name: 0,
        }
        for step, (connection, time, raw) in enumerate(reader.messages()):
            message = reader.deserialize(raw, connection.msgtype)
            assert (connection.topic, time) == (TOPICS[step % 2].name, step * 10**9)
            assert (message.step, message.time) == (step, step / 7)
            assert raw == sent[step]


def test_rosbags_reads_the_offered_qos(tmp_path: Path) -> None:
    write_bag(tmp_path / "bag", payloads(3))
    with AnyReader([tmp_path / "bag"]) as reader:
        qos = {c.topic: c.ext.offered_qos_profiles[0] for c in reader.connections}
    assert qos["/clock"].reliability.name == "BEST_EFFORT"
    assert qos["/clock"].depth == 1
    assert qos["/flock/bird_01/wing"].durability.name == "TRANSIENT_LOCAL"
    assert qos["/flock/bird_02/state"].history.name == "KEEP_ALL"
    assert qos["/flock/bird_01/state"].history.name == "KEEP_LAST"


def test_metadata_yaml_has_the_fields_of_version_9_in_rosbag2s_order(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "bag", payloads(10))
    information = yaml.safe_load((path.parent / "metadata.yaml").read_text())[
        "rosbag2_bagfile_information"
    ]
    assert list(information) == [
        "version",
        "storage_identifier",
        "duration",
        "starting_time",
        "message_count",
        "topics_with_message_count",
        "compression_format",
        "compression_mode",
        "relative_file_paths",
        "files",
        "custom_data",
        "ros_distro",
    ]
    assert information["version"] == 9
    assert information["starting_time"] == {"nanoseconds_since_epoch": 1_000}
    assert information["duration"] == {"nanoseconds": 63}
    assert information["message_count"] == 10
    assert information["files"] == [
        {
            "path": "bag_0.mcap",
            "starting_time": {"nanoseconds_since_epoch": 1_000},
            "duration": {"nanoseconds": 63},
            "message_count": 10,
        }
    ]
    topic = information["topics_with_message_count"][0]
    assert topic["message_count"] == 4
    assert list(topic["topic_metadata"]) == [
        "name",
        "type",
        "serialization_format",
        "offered_qos_profiles",
        "type_description_hash",
    ]
    assert topic["topic_metadata"]["type_description_hash"].startswith("RIHS01_")
    assert topic["topic_metadata"]["offered_qos_profiles"] == [
        {
            "history": "keep_last",
            "depth": 10,
            "reliability": "reliable",
            "durability": "volatile",
            "deadline": {"sec": 9223372036, "nsec": 854775807},
            "lifespan": {"sec": 9223372036, "nsec": 854775807},
            "liveliness": "automatic",
            "liveliness_lease_duration": {"sec": 9223372036, "nsec": 854775807},
            "avoid_ros_namespace_conventions": False,
        }
    ]
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    channel = summary.channels[1]
    assert (
        yaml.safe_load(channel.metadata["offered_qos_profiles"])
        == (topic["topic_metadata"]["offered_qos_profiles"])
    )
    assert channel.metadata["topic_type_hash"] == topic["topic_metadata"]["type_description_hash"]


def test_a_bag_without_messages_is_complete(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "bag", [])
    with AnyReader([path.parent]) as reader:
        assert reader.message_count == 0
    with path.open("rb") as file:
        assert list(make_reader(file, validate_crcs=True).iter_messages()) == []
    with BagReader(path.parent) as bag:
        assert (bag.missing, bag.last_time, list(bag.messages())) == (None, None, [])
        assert set(bag.message_counts.values()) == {0}
    information = yaml.safe_load((path.parent / "metadata.yaml").read_text())
    assert information["rosbag2_bagfile_information"]["duration"] == {"nanoseconds": 0}


def test_names_beyond_ascii_are_kept(tmp_path: Path) -> None:
    directory = tmp_path / "Gänse, 北へ: 'runs' #1"
    definition = Definition("a/msg/B", "string s  # ünïcode\n", "RIHS01_0")
    topic = Topic("/schwärme/鳥", "a/msg/B")
    with BagWriter(
        directory,
        [topic],
        {"ключ": {"é": "\n\t'\""}},
        custom_data={"ö": "ü: #"},
        define=lambda _: definition,
    ) as bag:
        bag.write(topic.name, 1, b"x")
    with BagReader(directory) as reader:
        assert reader.topics == {topic.name: "a/msg/B"}
        assert reader.metadata("ключ") == {"é": "\n\t'\""}
    with Reader(directory) as other:
        assert [c.topic for c in other.connections] == [topic.name]
    text = (directory / "metadata.yaml").read_text(encoding="utf-8")
    assert yaml.safe_load(text)["rosbag2_bagfile_information"]["custom_data"] == {"ö": "ü: #"}
