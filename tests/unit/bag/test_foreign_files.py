# SPDX-License-Identifier: Apache-2.0
"""The files of foreign bags: compressed, missing, hidden, or not listed."""

from __future__ import annotations

import shutil
from pathlib import Path
from random import Random

import pytest
import zstandard
from mcap.reader import make_reader
from mcap.writer import Writer

from flock_sim.bag.reading.compression import unpacked_message
from flock_sim.bag.reading.reader import BagReader
from flock_sim.bag.records import DamagedError
from flock_sim.bag.writing.partial_bag import recorded_in
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.console.arguments import run_tool
from flock_sim.errors import FlockError
from flock_tools.commands import compare, metrics, repair
from support.flights import record
from support.foreign import SECOND, word, write_bag, write_file, write_metadata
from support.foreign_play import WORDS, Played, heard, words
from support.tool_runs import json_of, text_of


@pytest.fixture
def play(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Played:
    return Played(monkeypatch, capsys)


@pytest.mark.parametrize("mode", ["MESSAGE", "FILE"])
def test_what_rosbag2_has_compressed_is_played_as_it_was_said(
    tmp_path: Path, play: Played, mode: str
) -> None:
    said = words(1, 2, 3)
    bag = write_bag(tmp_path / "bag", said, mode=mode)
    (file,) = bag.glob("*.mcap*")
    for path in (bag, file):
        assert play(path)["messages"] == 3
        assert play.heard == heard(*said)
        assert play.notes == []
    play(bag, "--start", "1.5")
    assert play.heard == heard(*said[2:])


@pytest.mark.parametrize("record", [True, False])
def test_what_is_compressed_is_never_said_as_it_is(
    tmp_path: Path, play: Played, record: bool
) -> None:
    # The bag of a recorder that was killed has no metadata.yaml; rosbag2 says the same in its file.
    said = words(1, 2)
    bag = write_bag(tmp_path / "bag", said, mode="MESSAGE")
    text = (bag / "metadata.yaml").read_text(encoding="utf-8")
    (bag / "metadata.yaml").unlink()
    if record:
        packed = [(each, time, zstandard.compress(data)) for each, time, data in said]
        write_file(bag / "bag_0.mcap", packed, record={"serialized_metadata": text})
    facts = play(bag)
    assert play.heard == (heard(*said) if record else [])
    assert facts["left_out"] == ({} if record else {"/words": 2})


def test_compressed_files_are_found_without_metadata(tmp_path: Path, play: Played) -> None:
    said = words(1, 2)
    bag = write_bag(tmp_path / "bag", said, mode="FILE")
    (bag / "metadata.yaml").unlink()
    play(bag)
    assert play.heard == heard(*said)


def test_files_that_were_unpacked_by_hand_are_read_once(tmp_path: Path, play: Played) -> None:
    said = words(1, 2)
    bag = write_bag(tmp_path / "bag", said, mode="FILE")
    write_file(bag / "bag_0.mcap", said)
    play(bag)
    assert (play.heard, play.notes) == (heard(*said), [])
    (bag / "metadata.yaml").unlink()
    play(bag)
    assert play.heard == heard(*said)


def test_a_compressed_file_that_is_cut_short_is_played_as_far_as_it_goes(
    tmp_path: Path, play: Played
) -> None:
    random = Random(7)  # so that it is long when it is compressed: of many blocks
    said = [(WORDS, float(k), word(random.randbytes(500).hex())) for k in range(1000)]
    bag = write_bag(tmp_path / "bag", said, mode="FILE", chunk=10_000)
    (file,) = bag.glob("*.zstd")
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    play(bag)
    assert 0 < len(play.heard) < len(said)
    assert play.heard == heard(*said)[: len(play.heard)]
    assert "not complete" in play.notes[0]


def test_a_message_that_does_not_decompress_is_said(tmp_path: Path, play: Played) -> None:
    bag = write_bag(tmp_path / "bag", words(1, 2))
    write_metadata(bag, ["bag_0.mcap"], "MESSAGE")  # though they are not compressed
    assert "is damaged (a message in it does not decompress" in play.error(bag)
    bomb = b"\x28\xb5\x2f\xfd\xe0" + b"\xff" * 8 + b"\0\0\0"  # it claims 2^64 - 1 bytes
    with pytest.raises(DamagedError):
        unpacked_message(bomb)


def test_a_compression_that_is_not_known_is_refused_by_its_name(
    tmp_path: Path, play: Played
) -> None:
    bag = write_bag(tmp_path / "bag", words(1), mode="MESSAGE")
    text = (bag / "metadata.yaml").read_text(encoding="utf-8")
    (bag / "metadata.yaml").write_text(text.replace("zstd", "brotli"), encoding="utf-8")
    assert "its messages are compressed as 'brotli', not as zstd" in play.error(bag)


def test_a_file_that_is_not_there_is_named(tmp_path: Path, play: Played) -> None:
    listed = ["bag_1.mcap", "bag_0.mcap", "bag_2.mcap", "bag_0.mcap"]
    bag = write_bag(tmp_path / "bag", words(1), words(2), listed=listed)
    assert play(bag)["messages"] == 2
    assert play.notes == [
        f"note: {bag} is not complete: bag_2.mcap is not there; its intact part is played"
    ]
    with BagReader(bag) as opened:
        assert [stamp for _, stamp, _ in opened.messages()] == [2 * SECOND, SECOND]


@pytest.mark.parametrize("content", [b"", b"no MCAP at all", b"\x28\xb5\x2f\xfd"])
def test_a_file_that_cannot_be_read_leaves_the_others(
    tmp_path: Path, play: Played, content: bytes
) -> None:
    # What a recorder leaves that is killed as it begins another file, for one.
    bag = write_bag(tmp_path / "bag", words(1), words(2), words(3))
    (bag / "bag_1.mcap").write_bytes(content)
    play(bag)
    assert play.heard == heard(*words(1, 3))
    (note,) = play.notes
    assert f"{bag} is not complete: bag_1.mcap is " in note
    for name in ("bag_0.mcap", "bag_2.mcap"):
        (bag / name).write_bytes(content)
    assert "bag_2.mcap is " in play.error(bag)


def test_a_file_that_is_not_listed_is_no_part_of_the_bag(tmp_path: Path, play: Played) -> None:
    bag = write_bag(tmp_path / "bag", words(1), words(2), listed=["bag/bag_0.mcap"])
    play(bag)
    assert play.heard == heard(*words(1))
    assert play.notes == ["note: bag_1.mcap is left out: metadata.yaml does not list it"]
    shutil.move(bag / "bag_0.mcap", bag / "renamed.mcap")
    write_metadata(bag, ["../other/bag_0.mcap"])
    play(bag)
    assert play.heard == heard(*words(1, 2))
    assert "bag_0.mcap is not there" in play.notes[0]


@pytest.mark.parametrize(
    "text", ["", "[", "7", "a: b", 9**6 * "[", 9**4 * "- ", "rosbag2_bagfile_information: 7"]
)
def test_a_metadata_that_cannot_be_read_is_said(tmp_path: Path, play: Played, text: str) -> None:
    bag = write_bag(tmp_path / "bag", words(1), words(2))
    (bag / "metadata.yaml").write_text(text, encoding="utf-8")
    play(bag)
    assert play.heard == heard(*words(1, 2))
    assert "metadata.yaml can't be read" in play.notes[0]


def test_hidden_files_beside_a_bag_are_ignored(tmp_path: Path, play: Played) -> None:
    bag = write_bag(tmp_path / "bag", words(1))
    (bag / "._bag_0.mcap").write_bytes(b"\x00\x05\x16\x07")
    for _ in range(2):
        play(bag)
        assert play.heard == heard(*words(1))
        (bag / "metadata.yaml").unlink(missing_ok=True)


def test_a_hidden_file_is_no_second_recording_to_go_on_with(tmp_path: Path) -> None:
    recorded = tmp_path / "bag_0.mcap"
    for name in (recorded.name, "._bag_0.mcap"):
        (tmp_path / name).touch()
    assert recorded_in(tmp_path) == recorded


def test_a_compressed_recording_is_not_gone_on_with(tmp_path: Path) -> None:
    (tmp_path / "bag_0.mcap.zstd").touch()
    with pytest.raises(FlockError, match=r"bag_0\.mcap\.zstd is compressed: unpack it"):
        recorded_in(tmp_path)


FLOWN = FlockConfiguration(birds=3, t_max=40.0)


def packed(bag: Path, mode: str) -> Path:
    """Compress a bag of ours as rosbag2 does; return its directory.

    LOOSE compresses nothing, and puts messages outside of chunks.
    """
    directory = bag.with_name(mode)
    directory.mkdir()
    (path,) = bag.glob("*.mcap")
    if mode == "FILE":
        name = f"{path.name}.zstd"
        (directory / name).write_bytes(zstandard.compress(path.read_bytes()))
    else:
        name = path.name
        with path.open("rb") as source, (directory / name).open("wb") as target:
            reader = make_reader(source)
            writer = Writer(target, use_chunking=mode != "LOOSE")
            writer.start(profile="ros2", library="a test")
            for record in reader.iter_metadata():
                writer.add_metadata(record.name, record.metadata)
            schemas: dict[str, int] = {}
            channels: dict[str, int] = {}
            for schema, channel, message in reader.iter_messages(log_time_order=False):
                assert schema is not None
                if channel.topic not in channels:
                    if schema.name not in schemas:
                        schemas[schema.name] = writer.register_schema(
                            schema.name, schema.encoding, schema.data
                        )
                    channels[channel.topic] = writer.register_channel(
                        channel.topic, "cdr", schemas[schema.name], channel.metadata
                    )
                writer.add_message(
                    channels[channel.topic],
                    message.log_time,
                    zstandard.compress(message.data) if mode == "MESSAGE" else message.data,
                    message.publish_time,
                )
            writer.finish()
    write_metadata(directory, [name], mode)
    return directory


def counted(bag: Path) -> int:
    with BagReader(bag) as whole:
        return sum(1 for _ in whole.messages())


def test_a_flight_whose_messages_are_outside_of_chunks_is_repaired(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = record(tmp_path / "bag", FLOWN)
    copy = packed(bag, "LOOSE")
    write_metadata(copy, ["bag_0.mcap", "another_1.mcap"])
    assert json_of(repair.tool, capsys, str(copy))["messages"] == counted(bag)
    assert json_of(compare.tool, capsys, str(bag), f"{copy}-repaired")["equal"]


@pytest.mark.parametrize("mode", ["FILE", "MESSAGE"])
def test_every_tool_reads_a_flight_that_was_compressed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], mode: str
) -> None:
    bag = record(tmp_path / "bag", FLOWN)
    copy = packed(bag, mode)
    facts = [json_of(metrics.tool, capsys, str(each)) for each in (bag, copy)]
    assert facts[0] == facts[1]
    assert json_of(compare.tool, capsys, str(bag), str(copy))["equal"]
    assert "nothing to repair" in text_of(repair.tool, capsys, str(copy))
    (file,) = copy.glob("*.mcap*")
    write_metadata(copy, [file.name, "another_1.mcap"], mode)
    assert json_of(repair.tool, capsys, str(copy))["messages"] == counted(bag)
    assert json_of(compare.tool, capsys, str(bag), f"{copy}-repaired")["equal"]


def test_what_is_missing_of_a_flight_is_told_by_every_tool(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = record(tmp_path / "bag", FLOWN)
    (file,) = bag.glob("*.mcap")
    (bag / f"._{file.name}").write_bytes(b"\x00\x05\x16\x07")
    write_metadata(bag, [file.name, "bag_1.mcap"])
    assert run_tool(metrics.tool, [str(bag)]) == 0
    assert "bag_1.mcap is not there" in capsys.readouterr().err
    facts = json_of(repair.tool, capsys, str(bag), "--output", str(tmp_path / "whole"))
    assert "bag_1.mcap is not there" in facts["missing"]
    assert "nothing to repair" in text_of(repair.tool, capsys, str(tmp_path / "whole"))
