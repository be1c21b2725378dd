# SPDX-License-Identifier: Apache-2.0
"""What `BagWriter` left behind in a file that it began, for it to go on with."""

import os
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from mcap.opcode import Opcode

from flock_sim.bag.chunk import (
    CHUNK_HEAD,
    MESSAGE,
    MESSAGE_FIELDS,
    chunk_head,
    message_indexes,
    summarise,
)
from flock_sim.bag.frames import FRAME, ChunkPlace, DamagedError, read_chunk, records_in
from flock_sim.bag.layout import Written
from flock_sim.errors import FlockError

_BLOCK = 1 << 20  # bytes read at once for the CRC
_AHEAD = 1 << 17  # bytes read at once from record to record: the message indexes of most chunks
_IN_HEAD = [bytes([opcode]) for opcode in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.METADATA)]
_TIME_AT = 6  # in a message's fields: behind its channel (2 bytes) and its sequence (4)


class Extent(NamedTuple):
    """A chunk with the message indexes that follow it."""

    offset: int  # bytes, of its frame
    length: int  # bytes of the chunk, with its frame
    end: int  # bytes, behind its message indexes


class Message(NamedTuple):
    """A message as `BagWriter.write` takes it."""

    topic: int  # its place among the topics, from 0
    log_time: int  # ns
    data: bytes


@dataclass(frozen=True)
class Kept:
    """The beginning of a file that is kept."""

    written: Written
    size: int  # bytes
    crc: int  # of all of them


class Begun:
    """The whole chunks of a file, in order, as far as they follow its head without a gap.

    `has_head` is False where the file ends within its head: nothing can be kept then. Memory:
    one chunk, and some 200 bytes for each chunk in the file.
    """

    def __init__(self, fd: int, path: Path, head: bytes) -> None:
        """Take stock of the file, which stays as it is.

        Raises FlockError where it begins with another head, OSError where it can't be read.
        """
        self._fd = fd
        self._path = path
        self._head = len(head)
        found = os.pread(fd, len(head), 0)
        following = os.pread(fd, 1, len(head))
        if not head.startswith(found) or following in _IN_HEAD:
            raise FlockError(
                f"{path} can't be gone on with: it was begun with another configuration, other"
                " topics or another version of Flock; give what it was begun with, or name"
                " another directory"
            )
        self.has_head = found == head
        self.chunks = _walk(path, len(head)) if self.has_head else []
        while self.chunks and not self._is_sound(self.chunks[-1]):
            self.chunks.pop()

    def messages(self, number: int) -> list[Message]:
        """Read the messages of chunk `number`, from 0; raises FlockError where it is damaged."""
        extent = self.chunks[number]
        try:
            return [
                Message(
                    int.from_bytes(content[:2], "little") - 1,
                    int.from_bytes(content[_TIME_AT : _TIME_AT + 8], "little"),
                    content[MESSAGE_FIELDS:],
                )
                for _, content in records_in(self._body(extent))
            ]
        except DamagedError as error:
            raise self._damaged(extent, error) from error

    def keep(self, chunks: int) -> Kept:
        """Sum up the file up to the end of its first `chunks` chunks, reading it once.

        Raises FlockError where it is damaged, OSError where it can't be read.
        """
        written = Written()
        for extent in self.chunks[:chunks]:
            head, indexes = self._surroundings(extent)
            try:
                written.add(summarise(head, indexes, extent.offset))
            except ValueError as error:
                raise self._damaged(extent, error) from error
        size = self.chunks[chunks - 1].end if chunks else self._head
        return Kept(written, size, _crc(self._fd, size))

    def _body(self, extent: Extent) -> bytes:
        place = ChunkPlace(extent.offset, extent.length, 0, 0, frozenset())
        return read_chunk(self._fd, place)

    def _surroundings(self, extent: Extent) -> tuple[bytes, bytes]:
        """Read what stands before and behind the compressed messages of a chunk."""
        indexes_at = extent.offset + extent.length
        return (
            os.pread(self._fd, CHUNK_HEAD, extent.offset),
            os.pread(self._fd, extent.end - indexes_at, indexes_at),
        )

    def _is_sound(self, extent: Extent) -> bool:
        """Whether all is there that `BagWriter` writes with the messages of a chunk."""
        try:
            body = self._body(extent)
            entries = _entries(body)
        except DamagedError:
            return False
        head = chunk_head(body, entries, extent.length - CHUNK_HEAD)
        return self._surroundings(extent) == (head, message_indexes(entries))

    def _damaged(self, extent: Extent, reason: ValueError) -> FlockError:
        return FlockError(
            f"{self._path} is damaged at byte {extent.offset} ({reason}): it can't be gone on"
            " with; save what is whole of it by ./flock repair"
        )


def recorded_in(directory: Path) -> Path | None:
    """Find the one recording in `directory`; None where there is none."""
    try:
        files = [entry for entry in directory.iterdir() if entry.suffix == ".mcap"]
    except FileNotFoundError:
        return None
    except OSError as error:
        raise FlockError(
            f"output {directory} can't be read ({error.strerror}): name another directory"
        ) from error
    if len(files) > 1:
        raise FlockError(
            f"{directory} holds {len(files)} .mcap files: only a bag of one can be gone on with"
        )
    return files[0] if files else None


def _walk(path: Path, offset: int) -> list[Extent]:
    """Find the chunks that follow each other from `offset` on, whole as far as lengths tell."""
    chunks: list[Extent] = []
    with path.open("rb", buffering=_AHEAD) as file:
        size = os.fstat(file.fileno()).st_size
        file.seek(offset)
        while len(frame := file.read(FRAME.size)) == FRAME.size:
            opcode, length = FRAME.unpack(frame)
            after = offset + FRAME.size + length
            if after > size:
                break
            if opcode == Opcode.CHUNK:
                chunks.append(Extent(offset, after - offset, after))
            elif opcode == Opcode.MESSAGE_INDEX and chunks:
                chunks[-1] = chunks[-1]._replace(end=after)
            else:
                break
            offset = after
            file.seek(offset)
    return chunks


def _entries(body: bytes) -> list[tuple[int, list[int]]]:
    """Tell where the messages of a chunk's body are; raises DamagedError."""
    entries: dict[int, list[int]] = {}
    at = 0
    for opcode, content in records_in(body):
        if opcode != Opcode.MESSAGE or len(content) < MESSAGE_FIELDS:
            raise DamagedError("a record in it is no message")
        _, _, channel, _, log_time, _ = MESSAGE.unpack_from(body, at)
        entries.setdefault(channel, []).extend((log_time, at))
        at += FRAME.size + len(content)
    if not entries:
        raise DamagedError("it is empty")
    return sorted(entries.items())


def _crc(fd: int, size: int) -> int:
    crc = 0
    for at in range(0, size, _BLOCK):
        crc = zlib.crc32(os.pread(fd, min(_BLOCK, size - at), at), crc)
    return crc
