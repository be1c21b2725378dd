# SPDX-License-Identifier: Apache-2.0
"""Writing a rosbag2 bag: the recorder's hot path, safe against kill -9 and a full disk."""

import os
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from types import TracebackType

from zstandard import ZstdCompressor

from flock_sim.bag.append_file import AppendFile
from flock_sim.bag.begun import Begun, recorded_in
from flock_sim.bag.definitions import Definition, installed_definition
from flock_sim.bag.layout import Layout, Written
from flock_sim.bag.open_chunk import OpenChunk
from flock_sim.bag.reserve import RESERVE_FILE, Reserve
from flock_sim.bag.rosbag2_metadata import METADATA_FILE, PART_FILE, metadata_yaml
from flock_sim.bag.topic import Topic
from flock_sim.errors import FlockError, RunFailed

_MAX_TOPICS = 65535  # MCAP numbers channels with 16 bits, from 1
_SLACK = 32 * 1024  # bytes, for the file system's own blocks and for counts that grow longer


class BagWriter:
    """Writes one bag directory: an MCAP file, and metadata.yaml when it is complete.

        with BagWriter("runs/demo", topics, {"flock": configuration}) as bag:
            bag.write("/flock/bird_01/state", log_time, cdr)
            bag.flush()  # safe against kill -9 from here on

    With `resume`, it goes on with a bag that was begun before, whatever ended that: a kill, a
    full disk, a power cut, or `close`. `begun` then gives access to the chunks that were whole,
    None otherwise; what followed them is cut off.

    Not thread-safe. Memory: one chunk, and 77 + 10 * (channels in it) bytes a chunk written.

    A full disk (or any other failure to write) raises RunFailed from `flush` or `write`; the
    file then ends with its last whole chunk, every later `write` raises the same RunFailed, and
    `close` still completes the bag, from space that was held back.
    """

    def __init__(
        self,
        directory: str | Path,
        topics: Sequence[Topic],
        metadata: Mapping[str, Mapping[str, str]],
        *,
        chunk_size: int = 1 << 20,
        compression_level: int = 1,
        custom_data: Mapping[str, str] | None = None,
        define: Callable[[str], Definition] = installed_definition,
        resume: bool = False,
    ) -> None:
        """Begin a bag in `directory`, which is made; one that exists must be empty.

        `resume`: go on with the bag in `directory`, which was begun with the same `topics` and
        `metadata`; begin one where there is none, or nothing of it but a part of its beginning.

        `metadata` are named records for the beginning of the file, before any message, where
        even a torn bag keeps them. `chunk_size` is in uncompressed bytes. `custom_data` goes to
        metadata.yaml. `define` tells a message type's definition.

        Raises FlockError for a directory that can't be used, topics named twice, types that are
        not installed or a bag that was begun with others; RunFailed where there is no room to
        begin. A bag that can't be gone on with stays as it is.
        """
        self.directory = Path(directory)
        self._topics = tuple(topics)
        self._custom_data = dict(custom_data or {})
        for name, times in Counter(topic.name for topic in topics).items():
            if times > 1:
                raise FlockError(f"topic {name} is given {times} times: name each topic once")
        if len(topics) > _MAX_TOPICS:
            raise FlockError(f"{len(topics)} topics: a bag holds at most {_MAX_TOPICS}")
        types = dict.fromkeys(topic.type for topic in topics)
        self._definitions = {name: define(name) for name in types}
        self._layout = Layout(self._topics, self._definitions, metadata)
        self._written = Written()

        self._chunk = OpenChunk([topic.name for topic in topics])
        self._limit = chunk_size
        self._compressor = ZstdCompressor(level=compression_level)
        self._failure: RunFailed | None = None
        self._closed = False

        self.begun: Begun | None = None
        self.path = self.directory / f"{self.directory.resolve().name}_0.mcap"
        self._reserve = Reserve(self.directory / RESERVE_FILE)
        self._reserved = len(self._layout.head) + len(self._metadata_text()) + _SLACK
        existing = recorded_in(self.directory) if resume else None
        if existing is None:
            self._begin()
        else:
            self.path = existing
            self._go_on()

    def write(
        self,
        topic: int | str,
        log_time: int,
        data: bytes,
        publish_time: int | None = None,
        sequence: int = 0,
    ) -> None:
        """Record one serialised message; `topic` is its name or its place in `topics`, from 0.

        Times are in ns, not negative; the publish time is the log time unless it is given. The
        message is safe after the next `flush`, which comes by itself when the chunk is full.

        Raises KeyError for an unknown topic, RunFailed as `flush` does.
        """
        chunk = self._chunk
        chunk.drop_incomplete()
        chunk.add(
            topic, log_time, data, log_time if publish_time is None else publish_time, sequence
        )
        self._take()

    def write_together(self, messages: Iterable[tuple[int | str, int, bytes]]) -> None:
        """Record messages (topic, log time, data) that no chunk is to end among.

        So what is on disk holds all of them or none. Raises as `write` does; none of them is
        recorded then, nor when the iteration raises.
        """
        chunk = self._chunk
        chunk.drop_incomplete()
        for topic, log_time, data in messages:
            chunk.add(topic, log_time, data, log_time, 0)
        self._take()

    def flush(self) -> None:
        """End the chunk and hand it to the operating system in one write.

        What was written before is safe from then on against the death of this process (against
        a power cut, once the system has written it out). Does nothing without new messages.

        Raises RunFailed when the chunk can't be stored: it is then left out altogether.
        """
        if self._failure is not None:
            self._chunk.clear()
            raise self._failure
        self._chunk.drop_incomplete()
        if not self._chunk.size:
            return
        sealed = self._chunk.seal(self._file.size, self._compressor)
        self._chunk.clear()
        try:
            self._reserve.hold(
                self._reserved + len(self._written.chunk_index) + len(sealed.summary.index)
            )
            self._file.append(sealed.record)
        except OSError as error:
            raise self._refuse(
                f"recording to {self.path} failed ({error.strerror}): the {self.messages_safe}"
                " messages recorded before are safe; make room and fly again"
            ) from error
        self._written.add(sealed.summary)

    def cut_back(self, chunks: int) -> None:
        """Keep only the first `chunks` chunks of a bag that is gone on with, just after that.

        Raises FlockError where it is damaged or can't be read or written.
        """
        if self.begun is None:
            raise ValueError("the bag is new: there is nothing to cut back")
        try:
            kept = self.begun.keep(chunks)
            self._file.cut(kept.size, kept.crc)
        except OSError as error:
            raise self._unusable(error) from error
        self._written = kept.written

    def leave(self) -> None:
        """Flush, and leave the bag without an end, to be gone on with later."""
        self._end(self._let_go)

    def close(self) -> None:
        """Flush, write the summary, and then metadata.yaml; a second call does nothing.

        Raises RunFailed when the last messages or the summary can't be stored, but not again
        for what an earlier `flush` has raised.
        """
        self._end(self._complete)

    def _end(self, how: Callable[[], None]) -> None:
        """Flush and end it `how`, once; nothing can be written from then on."""
        if self._closed:
            return
        self._closed = True
        try:
            if self._failure is None:
                self.flush()
        finally:
            how()
            self._refuse_closed()

    def _let_go(self) -> None:
        self._reserve.free()
        self._file.close()

    def __enter__(self) -> "BagWriter":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    @property
    def writable(self) -> bool:
        """Whether anything can be written: the bag is not closed, and nothing has failed."""
        return self._failure is None

    @property
    def messages_safe(self) -> int:
        """Messages that a kill -9 of this process can't lose any more."""
        return self._written.messages

    @property
    def chunks_safe(self) -> int:
        """Chunks that a kill -9 of this process can't lose any more; `flush` may add one."""
        return self._written.chunks

    def _begin(self) -> None:
        made = not self.directory.exists()
        try:
            self.directory.mkdir(parents=True, exist_ok=True)
            if any(self.directory.iterdir()):
                raise FlockError(f"output {self.directory} is not empty: name another directory")
            self._file = AppendFile(self.path)
        except OSError as error:
            raise self._unusable(error) from error
        try:
            self._reserve.hold(self._reserved)
            self._file.append(self._layout.head)
        except OSError as error:
            self._file.close()
            self._reserve.free()
            self.path.unlink()
            if made:
                self.directory.rmdir()
            raise RunFailed(
                f"the bag {self.directory} can't be begun ({error.strerror}):"
                " make room and try again"
            ) from error

    def _go_on(self) -> None:
        try:
            self._file = AppendFile(self.path, existing=True)
        except OSError as error:
            raise self._unusable(error) from error
        try:
            self._take_up()
        except OSError as error:
            self._file.close()
            raise self._unusable(error) from error
        except FlockError:
            self._file.close()
            raise

    def _take_up(self) -> None:
        """Cut off what is not whole, once it is certain that the bag can be gone on with."""
        begun = Begun(self._file.fd, self.path, self._layout.head)
        kept = begun.keep(len(begun.chunks))
        try:
            self._reserve.hold(self._reserved + len(kept.written.chunk_index))
        except OSError as error:
            self._reserve.free()
            raise RunFailed(
                f"the bag {self.directory} can't be gone on with ({error.strerror}):"
                " make room and try again"
            ) from error
        # metadata.yaml first: its presence says that the bag is complete.
        for name in (METADATA_FILE, PART_FILE):
            (self.directory / name).unlink(missing_ok=True)
        if begun.has_head:
            self._file.cut(kept.size, kept.crc)
        else:
            self._file.cut(0, 0)
            self._file.append(self._layout.head)
        self._written = kept.written
        self.begun = begun

    def _unusable(self, error: OSError) -> FlockError:
        return FlockError(
            f"output {self.directory} can't be written ({error.strerror}): name another directory"
        )

    def _complete(self) -> None:
        part = self.directory / PART_FILE
        try:
            self._reserve.free()
            self._file.append(self._layout.tail(self._written, self._file.size, self._file.crc))
            self._file.sync()
            # At one stroke, and after everything else is on the disk: its presence says so.
            with part.open("w", encoding="utf-8") as file:
                file.write(self._metadata_text())
                file.flush()
                os.fsync(file.fileno())
            part.replace(self.directory / METADATA_FILE)
        except OSError as error:
            with suppress(OSError):
                part.unlink(missing_ok=True)
            raise RunFailed(
                f"the bag {self.directory} can't be completed ({error.strerror}):"
                f" its {self.messages_safe} messages are safe"
            ) from error
        finally:
            self._file.close()

    def _metadata_text(self) -> str:
        return metadata_yaml(
            self.path.name, self._topics, self._definitions, self._written, self._custom_data
        )

    def _take(self) -> None:
        """Let count what was added, and end the chunk where it is full."""
        self._chunk.take()
        if self._chunk.size >= self._limit:
            self.flush()

    def _refuse(self, reason: str) -> RunFailed:
        """Let every later `write` and `flush` raise the failure returned, at no cost till then."""
        self._failure = RunFailed(reason)
        self._limit = 0
        return self._failure

    def _refuse_closed(self) -> None:
        self._refuse(f"the bag {self.directory} is closed: nothing can be written to it")
