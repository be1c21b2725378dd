# SPDX-License-Identifier: Apache-2.0
"""The records of an MCAP file: each has a frame of opcode and length; chunks contain records."""

import os
import struct
import zlib
from collections.abc import Callable, Iterator, Mapping
from io import BytesIO
from typing import NamedTuple, TypeVar

import lz4.frame  # type: ignore[import-untyped]
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile, McapError
from mcap.opcode import Opcode

from flock_sim.bag import limits

FRAME = struct.Struct("<BQ")  # opcode, length of the record that follows

MESSAGE_OPCODE = int(Opcode.MESSAGE)
MESSAGE_HEAD = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time (ns); then data
MESSAGE = struct.Struct(FRAME.format + MESSAGE_HEAD.format[1:])  # its frame and its head

CHUNK_TIMES = struct.Struct("<QQ")  # the beginning of a chunk: start and end time, ns
_CHUNK_HEAD = struct.Struct("<QQQII")  # ... uncompressed size, CRC, length of compression's name
_LENGTH = struct.Struct("<Q")

COMPRESSIONS = (b"\x04\x00\x00\x00zstd", b"\x03\x00\x00\x00lz4")
"""The compression field of chunks: the length of the name, and the name."""

COMPRESSION_AT = FRAME.size + _CHUNK_HEAD.size - 4
"""Offset of the compression field in a chunk, in bytes from its frame on."""

CRC_BLOCK = 1 << 20  # bytes that `crc_of` reads at once

_LAST_OFFSET = 1 << 62  # bytes; os.pread refuses offsets near 2^63

Record = TypeVar("Record")


class DamagedError(ValueError):
    """Bytes that violate the MCAP format; the text gives the reason."""


class ChunkPlace(NamedTuple):
    """The place of a chunk in the file, and its times and channels."""

    offset: int  # bytes, of its frame
    length: int  # bytes, with its frame
    start_time: int  # ns, of its earliest message
    end_time: int  # ns, of its latest message
    channels: frozenset[int]  # of its messages; empty if the file does not have them


class _ExactStream(ReadDataStream):
    """A stream that raises EndOfFile if a field is cut short."""

    def read(self, length: int) -> bytes:
        data = super().read(length)
        if len(data) != length:
            raise EndOfFile()
        return data


def parse(read: Callable[[ReadDataStream], Record], content: bytes) -> Record:
    """Make a record from its content, by mcap's own `read`; raises DamagedError."""
    try:
        return read(_ExactStream(BytesIO(content)))
    except (McapError, struct.error, ValueError) as error:
        raise DamagedError(f"a record does not parse: {error!r}") from error


def read_frame(fd: int, offset: int) -> tuple[int, int] | None:
    """Read opcode and content length of the frame at `offset`; None if the file ends there."""
    head = os.pread(fd, FRAME.size, offset) if offset <= _LAST_OFFSET else b""
    if len(head) < FRAME.size:
        return None
    opcode, length = FRAME.unpack(head)
    # 0 is no opcode: a power cut leaves zeros in blocks that were never written.
    return None if opcode == 0 else (opcode, length)


def read_content(fd: int, offset: int, length: int) -> bytes:
    """Read the content of the frame at `offset`.

    Raises DamagedError if the file is cut short, or the content is longer than a chunk may be.
    """
    # A damaged length must not cause an allocation of the size that it states.
    missing = offset + FRAME.size + length - os.fstat(fd).st_size
    if missing > 0:
        raise DamagedError(f"{missing} of {length} bytes are missing")
    _check_size(length)
    return os.pread(fd, length, offset + FRAME.size)


def read_chunk(fd: int, place: ChunkPlace, unpacked: limits.Unpacked | None = None) -> bytes:
    """Read the records of a chunk, decompressed, checked against its CRC; raises DamagedError.

    `unpacked` counts the size of all chunks of a pass; raises LimitError if it becomes too large.
    """
    frame = read_frame(fd, place.offset)
    if frame != (Opcode.CHUNK, place.length - FRAME.size):
        raise DamagedError("there is no chunk")
    content = read_content(fd, place.offset, place.length - FRAME.size)
    head = _chunk_head(content)
    if head.data_at + head.length > len(content):
        raise DamagedError("its data is cut short")
    _check_size(head.size, "unpacked bytes")
    if unpacked is not None:
        unpacked.add(head.size)
    data = content[head.data_at : head.data_at + head.length]
    body = _decompress(data, head.compression, head.size)
    if head.crc and zlib.crc32(body) != head.crc:
        raise DamagedError("its CRC does not match")
    return body


def read_cut_chunk(fd: int, offset: int) -> bytes:
    """Read the whole records of a chunk that the end of the file cuts; empty without such a chunk.

    No CRC covers them, but the bytes before the cut are those that were written: blocks of the
    compression that are not whole are left out.
    """
    frame = read_frame(fd, offset)
    there = os.fstat(fd).st_size - offset - FRAME.size
    if frame is None or frame[0] != Opcode.CHUNK or frame[1] <= there:
        return b""
    content = os.pread(fd, min(there, limits.LARGEST_CHUNK), offset + FRAME.size)
    try:
        head = _chunk_head(content)
    except DamagedError:
        return b""
    if head.data_at + head.length <= len(content) or head.size > limits.LARGEST_CHUNK:
        return b""  # its data is all there: the length of its frame is damaged
    return _whole_records(_decompress_start(content[head.data_at :], head))


class _ChunkHead(NamedTuple):
    size: int  # bytes, of the records
    crc: int
    compression: str
    data_at: int  # bytes, from the content's beginning
    length: int  # bytes, of the compressed data


def _chunk_head(content: bytes) -> _ChunkHead:
    """Return the fields before the data of a chunk; raises DamagedError."""
    try:
        _, _, size, crc, name_length = _CHUNK_HEAD.unpack_from(content)
        data_at = _CHUNK_HEAD.size + name_length + _LENGTH.size
        compression = content[_CHUNK_HEAD.size : data_at - _LENGTH.size].decode()
        (length,) = _LENGTH.unpack_from(content, data_at - _LENGTH.size)
    except (struct.error, ValueError) as error:
        raise DamagedError(f"its head does not parse: {error}") from error
    return _ChunkHead(size, crc, compression, data_at, length)


def _decompress_start(data: bytes, head: _ChunkHead) -> bytes:
    """Return what the beginning `data` of compressed data gives, at most `head.size` bytes."""
    pieces: list[bytes] = []
    try:
        if head.compression == "zstd":
            reader = zstandard.ZstdDecompressor().stream_reader(data)
            while sum(map(len, pieces)) < head.size and (piece := reader.read(CRC_BLOCK)):
                pieces.append(piece)
        elif head.compression == "lz4":
            pieces.append(lz4.frame.LZ4FrameDecompressor().decompress(data, head.size))
        elif head.compression == "":
            pieces.append(data)
    except (zstandard.ZstdError, RuntimeError, MemoryError):
        pass  # the pieces before are whole
    return b"".join(pieces)[: head.size]


def _whole_records(body: bytes) -> bytes:
    """Return the beginning of `body` up to the last record that is whole."""
    end = 0
    while end + FRAME.size <= len(body):
        after = end + FRAME.size + FRAME.unpack_from(body, end)[1]
        if after > len(body):
            break
        end = after
    return body[:end]


def _check_size(size: int, what: str = "bytes") -> None:
    if size > limits.LARGEST_CHUNK:
        raise DamagedError(f"it has {limits.beyond(size, limits.LARGEST_CHUNK, what)}")


def _decompress(data: bytes, compression: str, size: int) -> bytes:
    try:
        if compression == "zstd":
            # A damaged frame must not cause an allocation of the size that it states.
            if zstandard.frame_content_size(data) > size:
                raise DamagedError("its size does not fit")
            body = zstandard.ZstdDecompressor().decompress(data, max_output_size=size)
        elif compression == "lz4":
            body = _decompress_lz4(data, size)
        elif compression == "":
            body = data
        else:
            raise DamagedError(f"its compression {compression!r} must be zstd, lz4 or none")
    except (zstandard.ZstdError, RuntimeError, MemoryError) as error:
        raise DamagedError(f"it does not decompress: {error}") from error
    if len(body) != size:
        raise DamagedError("its size does not fit")
    return body


def _decompress_lz4(data: bytes, size: int) -> bytes:
    """Return what a frame gives, at most one byte more than `size`."""
    decompressor = lz4.frame.LZ4FrameDecompressor()
    body: bytes = decompressor.decompress(data, size + 1)
    if len(body) <= size and not decompressor.eof:
        raise DamagedError("it does not decompress: its end is missing")
    return body


def messages_in(
    body: bytes, topics: Mapping[int, str], start: int, end: int
) -> Iterator[tuple[str, int, bytes]]:
    """Yield the messages (topic, log time in ns, data) of a chunk's body, in its order.

    Only messages of the channels in `topics` with start <= log time < end are yielded. Raises
    DamagedError.
    """
    position = 0
    size = len(body)
    largest = limits.LARGEST_MESSAGE
    unpack = MESSAGE.unpack_from
    topic_of = topics.get
    try:
        while position < size:
            if body[position] != MESSAGE_OPCODE:
                position += FRAME.size + FRAME.unpack_from(body, position)[1]
                continue
            _, length, channel, _, log_time, _ = unpack(body, position)
            data_at = position + MESSAGE.size
            position += FRAME.size + length
            if position > size or data_at > position:
                raise DamagedError("a message in it is cut short")
            if length > largest:
                raise DamagedError(f"a message in it has {limits.beyond(length, largest, 'bytes')}")
            topic = topic_of(channel)
            if topic is not None and start <= log_time < end:
                yield topic, log_time, body[data_at:position]
    except struct.error as error:
        raise DamagedError(f"a record in it is cut short: {error}") from error


def records_in(body: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield opcode and content of each record in a body or a summary; raises DamagedError."""
    position = 0
    while position < len(body):
        if position + FRAME.size > len(body):
            raise DamagedError("a record in it is cut short")
        opcode, length = FRAME.unpack_from(body, position)
        position += FRAME.size + length
        if position > len(body):
            raise DamagedError("a record in it is cut short")
        yield opcode, body[position - length : position]


def crc_of(fd: int, size: int) -> int:
    """Return the CRC-32 of the first `size` bytes of an open file, or of all if it is shorter."""
    crc = 0
    for at in range(0, size, CRC_BLOCK):
        crc = zlib.crc32(os.pread(fd, min(CRC_BLOCK, size - at), at), crc)
    return crc
