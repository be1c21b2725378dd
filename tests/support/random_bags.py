# SPDX-License-Identifier: Apache-2.0
"""Random changes of genuine bags: of records, lengths, offsets, chunks, texts and CRCs.

The changed file is packed again with sizes and CRCs that fit, so that readers do not stop at them.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from random import Random

import lz4.frame  # type: ignore[import-untyped]
import zstandard
from mcap.opcode import Opcode
from mcap.records import Channel, Metadata, MetadataIndex, Schema, Statistics

from flock_sim.bag.file_sections import MAGIC, pack
from flock_sim.bag.records import FRAME, parse

NUMBERS = (0, 1, 2, 255, 2**16 - 1, 2**31 - 1, 2**31, 2**32 - 1, 2**62, 2**63 - 1, 2**63, 2**64 - 1)

TYPES = (
    *("", "/", "/msg/String", ".os/msg/path", "..std_msgs/msg/String", "std_msgs", "os/msg/Path"),
    *(
        "antigravity/msg/This",
        "this/msg/Zen",
        "std_msgs/msg/Nothing",
        "std_msgs/String",
        "\0/msg/A",
    ),
    *("flock_interfaces/msg/BirdState", "std_msgs/msg/" + "S" * 5000, "std_msgs/msg/Str\nng"),
)
TOPICS = ("", "/", "~", "//", "/clock", "/flock/bird_01/state", "/words\n", "\0", "/w" * 500)
TEXTS = (
    *("", "null", "nan", "Infinity", "1e999", "-1", "9" * 400, "2147483648", ".inf", "[]", "{}"),
    *('"\\ud800"', "[" * 60 + "]" * 60, "true", '"' + "x" * 1000 + '"', "\0", "- depth: .inf"),
    *("- depth: -3\n  history: 7", "- depth: 2147483648", "- <<: [1]", "&a [*a, *a]", "- - - -"),
    *("rosbag2_bagfile_information: {compression_mode: MESSAGE, compression_format: zstd}",),
)
DEFINITIONS = (b"", b"no definition \xff\xfe", b"string data\n" * 5000, b"=" * 80 + b"\nMSG: a/B\n")


@dataclass(frozen=True)
class Record:
    """A record; a chunk has `inner` records and the name of their compression."""

    opcode: int
    content: bytes
    inner: tuple[Record, ...] = ()
    compression: str = ""


@dataclass(frozen=True)
class Places:
    """The places of a packed record: its offset and length in bytes."""

    record: Record
    offset: int
    length: int


def split(content: bytes) -> list[Record]:
    """Return the records of a genuine file up to the end of its data, without message indexes."""
    found: list[Record] = []
    at = len(MAGIC)
    while True:
        opcode, length = FRAME.unpack_from(content, at)
        at += FRAME.size + length
        body = content[at - length : at]
        if opcode == Opcode.DATA_END:
            return found
        if opcode == Opcode.CHUNK:
            found.append(_unpacked(body))
        elif opcode != Opcode.MESSAGE_INDEX:
            found.append(Record(opcode, body))


def _unpacked(body: bytes) -> Record:
    (name_length,) = struct.unpack_from("<I", body, 28)
    compression = body[32 : 32 + name_length].decode()
    data = body[40 + name_length :]
    if compression == "zstd":
        data = zstandard.ZstdDecompressor().decompress(data, max_output_size=1 << 24)
    elif compression == "lz4":
        data = lz4.frame.decompress(data)
    inner: list[Record] = []
    at = 0
    while at < len(data):
        opcode, length = FRAME.unpack_from(data, at)
        at += FRAME.size + length
        inner.append(Record(opcode, data[at - length : at]))
    return Record(Opcode.CHUNK, body[:16], tuple(inner), compression)


def mutated(records: list[Record], random: Random) -> bytes:
    """Return a file made of `records` with some random changes."""
    changed = list(records)
    for _ in range(random.choice((0, 1, 1, 2, 4))):
        _change(changed, random)
    data, places = MAGIC, []
    for record in changed:
        packed = _packed(record, random)
        places.append(Places(record, len(data), len(packed)))
        data += packed
    data += FRAME.pack(Opcode.DATA_END, 4) + struct.pack("<I", random.choice((0, zlib.crc32(data))))
    content = data + _end(places, len(data), random)
    for _ in range(random.choice((0, 0, 0, 1, 3))):
        content = _with_number(content, random)
    if random.random() < 0.1:
        content = content[: random.randrange(len(content))]
    return content


def _change(records: list[Record], random: Random) -> None:
    """Change, repeat, move or remove one record, or one within a chunk."""
    if not records:
        return
    at = random.randrange(len(records))
    record = records[at]
    if record.inner and random.random() < 0.7:
        inner = list(record.inner)
        for _ in range(random.choice((1, 1, 3))):
            _change(inner, random)
        records[at] = replace(record, inner=tuple(inner))
        return
    kind = random.randrange(8)
    if kind == 0:
        del records[at]
    elif kind == 1:
        records[at:at] = [record] * random.choice((1, 2, 200))
    elif kind == 2:
        records.insert(random.randrange(len(records)), records.pop(at))
    elif kind == 3:
        records[at] = replace(record, opcode=random.choice((0, *range(1, 16), 0x80, 255)))
    elif kind == 4:
        records[at] = replace(record, content=_with_number(record.content, random))
    elif kind == 5:
        end = random.randrange(len(record.content) + 1)
        records[at] = replace(record, content=record.content[:end])
    else:
        records[at] = _with_other_text(record, random)


def _with_number(content: bytes, random: Random) -> bytes:
    """Put a number of 1, 2, 4 or 8 bytes somewhere, or change one bit."""
    if not content:
        return content
    at = random.randrange(len(content))
    if random.random() < 0.3:
        return content[:at] + bytes([content[at] ^ 1 << random.randrange(8)]) + content[at + 1 :]
    width = random.choice((1, 2, 4, 8))
    number = random.choice((*NUMBERS, len(content), len(content) + 1)) % (1 << 8 * width)
    return content[:at] + number.to_bytes(width, "little") + content[at + width :]


def _with_other_text(record: Record, random: Random) -> Record:
    """Replace a name, a type, a text or a key of a schema, a channel or a metadata record."""
    changes: dict[int, Callable[[Record, Random], bytes]] = {
        Opcode.SCHEMA: _other_schema,
        Opcode.CHANNEL: _other_channel,
        Opcode.METADATA: _other_metadata,
    }
    change = changes.get(record.opcode)
    if change is None:
        return record
    try:
        content = change(record, random)
    except ValueError:  # it was changed before
        return record
    return replace(record, content=content)


def _other_schema(record: Record, random: Random) -> bytes:
    schema: Schema = parse(Schema.read, record.content)
    if random.random() < 0.6:
        schema.name = random.choice(TYPES)
    else:
        schema.data = random.choice(DEFINITIONS)
    return pack(schema)[FRAME.size :]


def _other_channel(record: Record, random: Random) -> bytes:
    channel: Channel = parse(Channel.read, record.content)
    kind = random.randrange(4)
    if kind == 0:
        channel.topic = random.choice(TOPICS)
    elif kind == 1:
        channel.message_encoding = random.choice(("", "json", "\0", "cdr"))
    elif kind == 2:
        channel.schema_id = random.choice((0, 1, 2, 65535))
    else:
        key = random.choice(("offered_qos_profiles", "topic_type_hash", "other"))
        channel.metadata = {**channel.metadata, key: _text(channel.metadata.get(key, ""), random)}
    return pack(channel)[FRAME.size :]


def _other_metadata(record: Record, random: Random) -> bytes:
    found: Metadata = parse(Metadata.read, record.content)
    key = random.choice([*found.metadata, "serialized_metadata"])
    kind = random.randrange(4)
    if kind == 0:
        found.name = random.choice(("", "flock", "rosbag2", "free", "result", "machine_1"))
    elif kind == 1:
        found.metadata = {each: text for each, text in found.metadata.items() if each != key}
    else:
        found.metadata = {**found.metadata, key: _text(found.metadata.get(key, ""), random)}
    return pack(found)[FRAME.size :]


def _text(text: str, random: Random) -> str:
    """Return another text, or one with a changed word."""
    words = text.split()
    if words and random.random() < 0.4:
        words[random.randrange(len(words))] = random.choice(TEXTS)
        return " ".join(words)
    return random.choice(TEXTS)


def _packed(record: Record, random: Random) -> bytes:
    if record.opcode != Opcode.CHUNK or (not record.compression and not record.inner):
        return _framed(record, random)
    body = b"".join(_framed(each, random) for each in record.inner)
    compression = record.compression
    if random.random() < 0.05:
        compression = random.choice(("", "lz4", "zstd", "bz2"))
    if compression == "zstd":
        sized = random.random() < 0.8
        data = zstandard.ZstdCompressor(write_content_size=sized).compress(body)
    elif compression == "lz4":
        data = lz4.frame.compress(body)
    else:
        data = body
    if random.random() < 0.1:
        data = _with_number(data, random)  # such as the size in the head of the frame
    size, length = len(body), len(data)
    if random.random() < 0.1:
        size = random.choice((*NUMBERS, 10 * 2**30, len(body) + 1))
    if random.random() < 0.05:
        length = random.choice((*NUMBERS, len(data) + 1))
    crc = 0 if random.random() < 0.5 else zlib.crc32(body)
    name = compression.encode()
    head = record.content[:16].ljust(16, b"\0") + struct.pack("<QII", size, crc, len(name))
    content = head + name + struct.pack("<Q", length) + data
    return _framed(Record(Opcode.CHUNK, content), random)


def _framed(record: Record, random: Random) -> bytes:
    length = len(record.content)
    if random.random() < 0.003:
        length = random.choice((*NUMBERS, length + 1))
    return FRAME.pack(record.opcode, length) + record.content


def _end(places: list[Places], start: int, random: Random) -> bytes:
    """Return the summary of a file whose data ends at byte `start`, with some changes."""
    footer = FRAME.pack(Opcode.FOOTER, 20)
    if random.random() < 0.1:
        return footer + bytes(20) + MAGIC  # no summary
    summary = _summary(places, random)
    for _ in range(random.choice((0, 0, 1, 3))):
        _change(summary, random)
    block = b"".join(_framed(each, random) for each in summary)
    begin = random.choice(NUMBERS) if random.random() < 0.02 else start
    signed = footer + struct.pack("<QQ", begin, 0)
    crc = random.choice((0, zlib.crc32(signed, zlib.crc32(block))))
    return block + signed + struct.pack("<I", crc) + MAGIC


def _summary(places: list[Places], random: Random) -> list[Record]:
    inner = [each for place in places for each in (place.record, *place.record.inner)]
    summary = [each for each in inner if each.opcode in (Opcode.SCHEMA, Opcode.CHANNEL)]
    chunks = [place for place in places if place.record.opcode == Opcode.CHUNK]
    noted = [place for place in places if place.record.opcode == Opcode.METADATA]
    numbers = sorted({each.content[:2] for each in summary if each.opcode == Opcode.CHANNEL})
    for place in chunks:
        listed = b"".join(number + bytes(8) for number in numbers) if random.random() < 0.9 else b""
        times = place.record.content[:16].ljust(16, b"\0")
        index = struct.pack("<QQI", place.offset, place.length, len(listed)) + listed
        index += struct.pack("<QI", 0, 4) + b"zstd" + struct.pack("<QQ", 0, 0)
        summary.append(Record(Opcode.CHUNK_INDEX, times + index))
    for place in noted:
        index = pack(MetadataIndex(place.offset, place.length, ""))[FRAME.size :]
        summary.append(Record(Opcode.METADATA_INDEX, index))
    times = [struct.unpack("<QQ", each.record.content[:16].ljust(16, b"\0")) for each in chunks]
    counts = {int.from_bytes(number, "little"): 5 for number in numbers if len(number) == 2}
    statistics = Statistics(
        attachment_count=0,
        channel_count=len(numbers),
        channel_message_counts=counts,
        chunk_count=len(chunks),
        message_count=5 * len(numbers),
        message_start_time=min((first for first, _ in times), default=0),
        message_end_time=max((last for _, last in times), default=0),
        metadata_count=len(noted),
        schema_count=1,
    )
    return [*summary, Record(Opcode.STATISTICS, pack(statistics)[FRAME.size :])]
