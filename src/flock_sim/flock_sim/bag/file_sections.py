# SPDX-License-Identifier: Apache-2.0
"""The parts of an MCAP file around its chunks: the head before them, the summary after them."""

import zlib
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from flock_sim.bag.chunk import ChunkSummary
from flock_sim.bag.definitions import Definition
from flock_sim.bag.topic import Topic
from flock_sim.errors import FlockError

MAGIC = b"\x89MCAP0\r\n"
_MAX_TOPICS = 65535  # MCAP numbers channels with 16 bits, from 1
# Without a version: only metadata records depend on the versions that are installed.
_LIBRARY = "flock"


def pack(*records: McapRecord) -> bytes:
    """Serialise the records, one after the other."""
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    packed: bytes = builder.end()  # type: ignore[no-untyped-call]
    return packed


@dataclass
class Written:
    """The content of the chunks written so far, for the summary.

    Memory: `chunk_index` grows by 77 + 10 * (channels in it) bytes a chunk.
    """

    counts: dict[int, int] = field(default_factory=dict)  # messages by channel
    start_time: int = 0  # ns, of the earliest message; 0 when there is none
    end_time: int = 0  # ns, of the latest message
    chunks: int = 0
    chunk_index: bytearray = field(default_factory=bytearray)  # packed ChunkIndex records
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)  # records after the head
    metadata_index: list[MetadataIndex] = field(default_factory=list)  # of these records

    @property
    def messages(self) -> int:
        """Messages in whole chunks."""
        return sum(self.counts.values())

    def add(self, chunk: ChunkSummary) -> None:
        """Count one more chunk."""
        self.start_time = (
            min(self.start_time, chunk.start_time) if self.chunks else chunk.start_time
        )
        self.end_time = max(self.end_time, chunk.end_time)
        self.chunks += 1
        self.chunk_index += chunk.index
        for channel, count in chunk.counts:
            self.counts[channel] = self.counts.get(channel, 0) + count

    def add_metadata(self, record: Metadata, offset: int, length: int) -> None:
        """Register a metadata record of `length` bytes at byte `offset`."""
        self.metadata[record.name] = record.metadata
        self.metadata_index.append(MetadataIndex(offset, length, record.name))


class Layout:
    """The records of one bag that are known from the start.

    Channel i (1, 2, ...) is the i-th topic; schemas are numbered by first use. The head holds
    channels and schemas outside of chunks, so that all whole chunks of a torn file can be read.
    """

    def __init__(
        self,
        topics: Sequence[Topic],
        define: Callable[[str], Definition],
        metadata: Mapping[str, Mapping[str, str]],
    ) -> None:
        """Arrange a bag with these topics and metadata; `define` gives the definition of a type.

        Raises FlockError for topics named twice, or too many; and as `define` does.
        """
        for name, times in Counter(topic.name for topic in topics).items():
            if times > 1:
                raise FlockError(f"topic {name} is given {times} times: name each topic once")
        if len(topics) > _MAX_TOPICS:
            raise FlockError(f"{len(topics)} topics: a bag holds at most {_MAX_TOPICS}")
        self.topics = tuple(topics)
        self.definitions = {
            name: define(name) for name in dict.fromkeys(topic.type for topic in topics)
        }
        schema_ids = {name: number for number, name in enumerate(self.definitions, start=1)}
        self._schemas = [
            Schema(id=schema_ids[name], data=known.text.encode(), encoding="ros2msg", name=name)
            for name, known in self.definitions.items()
        ]
        self._channels = [
            Channel(
                id=number,
                topic=topic.name,
                message_encoding="cdr",
                metadata={
                    "offered_qos_profiles": topic.qos_text(),
                    "topic_type_hash": self.definitions[topic.type].type_hash,
                },
                schema_id=schema_ids[topic.type],
            )
            for number, topic in enumerate(topics, start=1)
        ]
        self._metadata_index: list[MetadataIndex] = []
        head = MAGIC + pack(Header(profile="ros2", library=_LIBRARY))
        head += _metadata_records(metadata, len(head), self._metadata_index)
        self.head = head + pack(*self._schemas, *self._channels)

    def tail(
        self, written: Written, size: int, crc: int, metadata: Mapping[str, Mapping[str, str]]
    ) -> bytes:
        """Make the part after the last chunk: `metadata`, end of data, summary, footer and magic.

        `size` is the size of the file so far, in bytes, and `crc` its CRC-32.
        """
        metadata_index = [*self._metadata_index, *written.metadata_index]
        last = _metadata_records(metadata, size, metadata_index)
        statistics = Statistics(
            attachment_count=0,
            channel_count=len(self._channels),
            channel_message_counts=written.counts,
            chunk_count=written.chunks,
            message_count=written.messages,
            message_end_time=written.end_time,
            message_start_time=written.start_time,
            metadata_count=len(metadata_index),
            schema_count=len(self._schemas),
        )
        end_of_data = last + pack(DataEnd(zlib.crc32(last, crc)))
        summary_start = size + len(end_of_data)
        summary = bytearray()
        offsets: list[SummaryOffset] = []
        for opcode, group in (
            (Opcode.SCHEMA, pack(*self._schemas)),
            (Opcode.CHANNEL, pack(*self._channels)),
            (Opcode.STATISTICS, pack(statistics)),
            (Opcode.CHUNK_INDEX, written.chunk_index),
            (Opcode.METADATA_INDEX, pack(*metadata_index)),
        ):
            if group:
                offsets.append(SummaryOffset(opcode, summary_start + len(summary), len(group)))
                summary += group
        offsets_start = summary_start + len(summary)
        summary += pack(*offsets)
        # The summary's CRC covers the footer's own fields before the CRC, its last 4 bytes.
        unsigned = pack(Footer(summary_start, offsets_start, 0))[:-4]
        crc = zlib.crc32(unsigned, zlib.crc32(summary))
        return end_of_data + summary + pack(Footer(summary_start, offsets_start, crc)) + MAGIC


def _metadata_records(
    metadata: Mapping[str, Mapping[str, str]], offset: int, index: list[MetadataIndex]
) -> bytes:
    """Pack metadata records for byte `offset` of a file, and add them to `index`."""
    packed = bytearray()
    for name, values in metadata.items():
        record = pack(Metadata(name=name, metadata=dict(values)))
        index.append(MetadataIndex(offset + len(packed), len(record), name))
        packed += record
    return bytes(packed)
