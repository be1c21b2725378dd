# SPDX-License-Identifier: Apache-2.0
"""The content of an incomplete file of `BagWriter`, which `BagWriter` can resume."""

import os
from dataclasses import dataclass
from itertools import takewhile
from pathlib import Path
from typing import NamedTuple

from mcap.opcode import Opcode
from mcap.records import Metadata

from flock_sim.bag.chunk import CHUNK_HEAD, fits, summarise
from flock_sim.bag.directory import NEW_FILE, is_recording
from flock_sim.bag.file_sections import Written
from flock_sim.bag.index import has_end
from flock_sim.bag.limits import LARGEST_DEFINITION, LimitError, Unpacked
from flock_sim.bag.reading.compression import FORMAT
from flock_sim.bag.records import (
    FRAME,
    MESSAGE_HEAD,
    ChunkPlace,
    DamagedError,
    crc_of,
    parse,
    read_chunk,
    records_in,
)
from flock_sim.bag.salvage import goes_on
from flock_sim.errors import FlockError

_AHEAD = 1 << 17  # bytes read at once from record to record: the message indexes of most chunks
_IN_HEAD = [bytes([opcode]) for opcode in (Opcode.SCHEMA, Opcode.CHANNEL)]
_TIME_AT = 6  # in a message's fields: behind its channel (2 bytes) and its sequence (4)


class Extent(NamedTuple):
    """A chunk with the message indexes that follow it."""

    offset: int  # bytes, of its frame
    length: int  # bytes of the chunk, with its frame
    end: int  # bytes, behind its message indexes


class Message(NamedTuple):
    """A message with the arguments of `BagWriter.write`."""

    topic: int  # its place among the topics, from 0
    log_time: int  # ns
    data: bytes


class Note(NamedTuple):
    """A metadata record behind the head."""

    offset: int  # bytes, of its frame
    end: int  # bytes
    record: Metadata


@dataclass(frozen=True)
class Kept:
    """The beginning of a file that is kept."""

    written: Written
    size: int  # bytes
    crc: int  # of all of them


class PartialBag:
    """The sound chunks of a file, in order, that follow its head without a gap.

    Metadata records may lie before and between them, and are kept with the chunk that follows.
    `has_head` is False if the file ends within its head: nothing can be kept then. `damage` is the
    end of these chunks, in bytes, if the file is damaged there and more data follows; None if the
    file is whole, or only ends too early. Memory: one chunk, and some 200 bytes for each chunk.
    """

    def __init__(self, fd: int, path: Path, head: bytes) -> None:
        """Read the whole file and find its sound chunks. The file does not change.

        Raises FlockError if it begins with another head, OSError if it can't be read.
        """
        self.fd = fd
        self._path = path
        self._head = len(head)
        found = os.pread(fd, len(head), 0)
        following = os.pread(fd, 1, len(head))
        if not head.startswith(found) or following in _IN_HEAD:
            raise FlockError(
                f"{path} can't be continued: it was recorded with another configuration, other"
                " topics or another version of Flock, or its beginning is damaged; use what it"
                " was recorded with, or name another directory"
            )
        self.has_head = found == head
        found_chunks, self._notes = _walk(path, len(head)) if self.has_head else ([], [])
        unpacked = Unpacked(fd)
        try:
            self.chunks = list(
                takewhile(lambda extent: self._is_sound(extent, unpacked), found_chunks)
            )
        except LimitError as error:
            raise FlockError(f"{path} {error}: it can't be continued") from error
        self.damage = self._damage() if self.has_head else None

    def _damage(self) -> int | None:
        """Return the byte of the damage if data follows it; None if the file ends there."""
        after = self.chunks[-1].end if self.chunks else self._head
        for note in self._notes:
            after = note.end if note.offset == after else after
        at_end = os.pread(self.fd, 1, after) in (b"", bytes([Opcode.DATA_END]))
        if at_end:
            return None
        return after if goes_on(self.fd, after) or has_end(self.fd) else None

    def messages(self, number: int) -> list[Message]:
        """Read the messages of chunk `number`, from 0.

        Raises FlockError if it is damaged or can't be read.
        """
        extent = self.chunks[number]
        try:
            return [
                Message(
                    int.from_bytes(content[:2], "little") - 1,
                    int.from_bytes(content[_TIME_AT : _TIME_AT + 8], "little"),
                    content[MESSAGE_HEAD.size :],
                )
                for _, content in records_in(self._body(extent))
            ]
        except DamagedError as error:
            raise self._damaged(extent, error) from error
        except OSError as error:
            raise FlockError(f"{self._path} can't be read: {error.strerror}") from error

    def keep(self, chunks: int) -> Kept:
        """Summarise the file up to the end of its first `chunks` chunks; it is read once.

        Raises FlockError if it is damaged, OSError if it can't be read.
        """
        written = Written()
        for extent in self.chunks[:chunks]:
            head, indexes = self._surroundings(extent)
            try:
                written.add(summarise(head, indexes, extent.offset))
            except ValueError as error:
                raise self._damaged(extent, error) from error
        size = self.chunks[chunks - 1].end if chunks else self._head
        for offset, end, record in self._notes:
            if offset < size:
                written.add_metadata(record, offset, end - offset)
        return Kept(written, size, crc_of(self.fd, size))

    def _body(self, extent: Extent, unpacked: Unpacked | None = None) -> bytes:
        place = ChunkPlace(extent.offset, extent.length, 0, 0, frozenset())
        return read_chunk(self.fd, place, unpacked)

    def _surroundings(self, extent: Extent) -> tuple[bytes, bytes]:
        """Read the head of a chunk and the message indexes that follow it."""
        indexes_at = extent.offset + extent.length
        return (
            os.pread(self.fd, CHUNK_HEAD, extent.offset),
            os.pread(self.fd, extent.end - indexes_at, indexes_at),
        )

    def _is_sound(self, extent: Extent, unpacked: Unpacked) -> bool:
        """Whether a chunk is undamaged and has the head and message indexes of `BagWriter`."""
        try:
            body = self._body(extent, unpacked)
        except DamagedError:
            return False
        return fits(body, *self._surroundings(extent), extent.length - CHUNK_HEAD)

    def _damaged(self, extent: Extent, reason: ValueError) -> FlockError:
        return FlockError(
            f"{self._path} is damaged at byte {extent.offset} ({reason}): it can't be"
            " continued; recover its undamaged part with ./flock repair"
        )


def recorded_in(directory: Path) -> Path | None:
    """Find the recording in `directory`; None if there is none.

    A new recording that has not yet replaced another one takes precedence.
    """
    try:
        names = [entry.name for entry in directory.iterdir()]
    except FileNotFoundError:
        return None
    except OSError as error:
        raise FlockError(
            f"output {directory} can't be read ({error.strerror}): name another directory"
        ) from error
    if NEW_FILE in names:
        return directory / NEW_FILE
    for name in names:
        if name.endswith(f".{FORMAT}") and is_recording(name.removesuffix(f".{FORMAT}")):
            raise FlockError(f"{directory} can't be continued: {name} is compressed: unpack it")
    files = [directory / name for name in names if is_recording(name)]
    if len(files) > 1:
        raise FlockError(
            f"{directory} holds {len(files)} .mcap files: only a bag with one can be continued"
        )
    return files[0] if files else None


def _walk(path: Path, offset: int) -> tuple[list[Extent], list[Note]]:
    """Find the consecutive records from `offset` on that are whole according to their lengths.

    Returns the chunks, with the message indexes that follow them, and the metadata records.
    """
    chunks: list[Extent] = []
    notes: list[Note] = []
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
            elif opcode == Opcode.MESSAGE_INDEX and chunks and chunks[-1].end == offset:
                chunks[-1] = chunks[-1]._replace(end=after)
            elif opcode == Opcode.METADATA and length <= LARGEST_DEFINITION:
                try:
                    notes.append(Note(offset, after, parse(Metadata.read, file.read(length))))
                except DamagedError:
                    break
            else:
                break
            offset = after
            file.seek(offset)
    return chunks, notes
