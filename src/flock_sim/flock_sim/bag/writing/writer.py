# SPDX-License-Identifier: Apache-2.0
"""The writer of a rosbag2 bag: the recorder's hot path, safe against kill -9 and a full disk."""

import os
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from types import TracebackType

from zstandard import ZstdCompressor

from flock_sim.bag.definitions import Definition, installed_definition
from flock_sim.bag.directory import (
    METADATA_FILE,
    NEW_FILE,
    PART_FILE,
    RESERVE_FILE,
    bag_files,
    is_recording,
)
from flock_sim.bag.file_sections import Layout, Written
from flock_sim.bag.metadata import metadata_yaml
from flock_sim.bag.topic import Topic
from flock_sim.bag.writing.open_chunk import OpenChunk
from flock_sim.bag.writing.partial_bag import PartialBag, recorded_in
from flock_sim.bag.writing.put_aside import put_aside
from flock_sim.bag.writing.reserve import Reserve
from flock_sim.bag.writing.storage import AppendFile, LostError
from flock_sim.errors import FlockError, RunFailed

_MAX_TOPICS = 65535  # MCAP numbers channels with 16 bits, from 1
_SLACK = 32 * 1024  # bytes, for the file system's own blocks and for counts that grow longer


class BagWriter:
    """Writes one bag directory: an MCAP file, and metadata.yaml when the bag is complete.

        with BagWriter("runs/demo", topics, {"flock": configuration}) as bag:
            bag.write("/flock/bird_01/state", log_time, cdr)
            bag.flush()  # safe against kill -9 from here on

    With `resume`, it continues a bag after a kill, a full disk, a power cut, or `close`. `begun`
    then gives access to the whole chunks of this bag, and is None otherwise. Data after the whole
    chunks is cut off.

    It is not thread-safe. Memory: one chunk, and 77 + 10 * (channels in it) bytes a chunk written.

    A full disk (or any other write error) raises RunFailed from `flush` or `write`. The file then
    ends with its last whole chunk, every later `write` raises the same RunFailed, and `close` still
    completes the bag in reserved space. If another process has removed the file or written to it,
    RunFailed reports this, and the bag is never completed.

    With `replace`, an existing bag in the directory stays until `take_place`. It stays for good if
    the new bag ends before, by `discard` or because nothing was written.
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
        replace: bool = False,
    ) -> None:
        """Begin a bag in `directory`, which is made; an existing directory must be empty.

        `resume`: continue the bag in `directory`, which was begun with the same `topics` and
        `metadata`. Begin a new one if there is no bag, or only a part of its head. A file with data
        after damage is kept under another name, `aside`; the bag then ends before the damage.
        `replace`: `directory` may have a bag, which is replaced.

        `metadata` are named records at the beginning of the file, before any message, so that even
        a torn bag has them. `chunk_size` is in uncompressed bytes. `custom_data` goes to
        metadata.yaml. `define` returns the definition of a message type.

        Raises FlockError for a directory that can't be used, topics named twice, types that are
        not installed, or a bag that was begun with other topics or metadata; RunFailed if there is
        no room to begin. A bag that can't be resumed is not changed.
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
        self._lost = False
        self._closed = False

        self.begun: PartialBag | None = None
        self.aside: Path | None = None
        self._replaces = False
        self._place = self.directory / f"{self.directory.resolve().name}_0.mcap"
        self.path = self._place
        self._reserve = Reserve(self.directory / RESERVE_FILE)
        self._reserved = len(self._layout.head) + len(self._metadata_text()) + _SLACK
        existing = recorded_in(self.directory) if resume else None
        if existing is None:
            self._begin(replace)
        else:
            self.path = existing
            self._replaces = existing.name == NEW_FILE
            self._go_on()

    def write(
        self,
        topic: int | str,
        log_time: int,
        data: bytes,
        publish_time: int | None = None,
        sequence: int = 0,
    ) -> None:
        """Record one serialised message; `topic` is its name or its index in `topics`, from 0.

        Times are in ns, not negative; the publish time is the log time unless it is given. The
        message is safe after the next `flush`. A full chunk is flushed automatically.

        Raises KeyError for an unknown topic, RunFailed as `flush` does.
        """
        chunk = self._chunk
        chunk.drop_incomplete()
        chunk.add(
            topic, log_time, data, log_time if publish_time is None else publish_time, sequence
        )
        self._take()

    def write_together(self, messages: Iterable[tuple[int | str, int, bytes]]) -> None:
        """Record messages (topic, log time, data) together in one chunk.

        So the file on disk has all of them or none. Raises the same errors as `write`. None of them
        is recorded then, or if the iteration raises.
        """
        chunk = self._chunk
        chunk.drop_incomplete()
        for topic, log_time, data in messages:
            chunk.add(topic, log_time, data, log_time, 0)
        self._take()

    def flush(self) -> None:
        """End the chunk and hand it to the operating system in one write.

        Messages written before are then safe if this process is killed (in a power cut, after the
        system has written them to the disk). Does nothing without new messages.

        Raises RunFailed if the chunk can't be stored: it is then left out completely.
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
            self._file.check()
            self._reserve.hold(
                self._reserved + len(self._written.chunk_index) + len(sealed.summary.index)
            )
            self._file.append(sealed.record)
        except LostError as error:
            raise self._lose(error) from error
        except OSError as error:
            raise self._refuse(
                f"recording to {self.path} failed ({error.strerror}): the {self.messages_safe}"
                " messages recorded before are safe; make room and fly again"
            ) from error
        self._written.add(sealed.summary)

    def check(self) -> None:
        """Raise RunFailed if the file was removed or changed, without reading unchanged content."""
        if not (self._lost or self._closed):
            try:
                self._file.check()
            except LostError as error:
                raise self._lose(error) from error

    def cut_back(self, chunks: int, *, keep_aside: bool = False) -> None:
        """Keep only the first `chunks` chunks of a resumed bag. Call it before any other write.

        `keep_aside`: the complete file stays under another name.

        Raises FlockError if the bag is damaged or can't be read or written.
        """
        if self.begun is None:
            raise ValueError("the bag is new: there is nothing to cut back")
        kept = self.begun.keep(chunks)
        if keep_aside:
            self._put_aside(kept.size)
        try:
            self._file.cut(kept.size, kept.crc)
        except OSError as error:
            raise self._unusable(error) from error
        self._written = kept.written

    def take_place(self) -> None:
        """Remove the bag that this one replaces, and take its place; raises RunFailed."""
        if not self._replaces:
            return
        self.check()
        old = [entry for entry in bag_files(self.directory) if is_recording(entry.name)]
        place = self._place
        kept = (*old[:1], self.path, self._reserve.path)
        try:
            for entry in bag_files(self.directory):
                if entry not in kept:
                    entry.unlink()
            # The old file gets the name first, so that a kill at any time leaves one of the two.
            if old and old[0] != place:
                old[0].replace(place)
            self.path.replace(place)
        except OSError as error:
            raise self._refuse(
                f"the bag in {self.directory} can't be replaced ({error.strerror}): name another"
                " directory"
            ) from error
        self._replaces = False
        self.path = self._file.path = place

    def discard(self) -> None:
        """Remove the bag; a bag that it was to replace stays."""
        if not self._closed:
            self._closed = True
            self._remove()
            self._refuse_closed()

    def _remove(self) -> None:
        with suppress(OSError):
            if not self._lost:
                self.path.unlink()
        self._replaces = False
        self._let_go()

    def leave(self) -> None:
        """Flush, and close the file without completing the bag, which can be resumed later."""
        self._end(self._let_go)

    def close(self) -> None:
        """Flush, write the summary, and then metadata.yaml; a second call does nothing.

        Raises RunFailed if the last messages or the summary can't be stored. An error that an
        earlier `flush` raised is not raised again.
        """
        self._end(self._complete)

    def _end(self, how: Callable[[], None]) -> None:
        """Flush and call `how` to end the bag, once; nothing can be written from then on."""
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
    def replaces(self) -> bool:
        """Whether this bag has still to replace another one."""
        return self._replaces

    def count(self, topic: int) -> int:
        """Return the number of messages of a topic, by its index from 0, in chunks on disk."""
        return self._written.counts.get(topic + 1, 0)

    @property
    def closed(self) -> bool:
        """Whether the bag was closed, left or discarded."""
        return self._closed

    @property
    def messages_safe(self) -> int:
        """Number of messages that are safe after a kill -9 of this process."""
        return self._written.messages

    @property
    def chunks_safe(self) -> int:
        """Number of chunks that are safe after a kill -9 of this process; `flush` may add one."""
        return self._written.chunks

    def _begin(self, replace: bool) -> None:
        made = not self.directory.exists()
        try:
            self.directory.mkdir(parents=True, exist_ok=True)
            if any(self.directory.iterdir()):
                if not replace:
                    raise FlockError(
                        f"output {self.directory} is not empty: name another directory"
                    )
                self._replaces = True
                self.path = self.directory / NEW_FILE
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
        """Cut off data that is not whole, after checks that the bag can be resumed."""
        begun = PartialBag(self._file.fd, self.path, self._layout.head)
        kept = begun.keep(len(begun.chunks))
        if begun.damage is not None:
            self._put_aside(kept.size)
            begun.fd = self._file.fd
        try:
            self._reserve.hold(self._reserved + len(kept.written.chunk_index))
        except OSError as error:
            self._reserve.free()
            raise RunFailed(
                f"the bag {self.directory} can't be gone on with ({error.strerror}):"
                " make room and try again"
            ) from error
        # metadata.yaml first: its presence says that the bag is complete.
        if not self._replaces:
            for name in (METADATA_FILE, PART_FILE):
                (self.directory / name).unlink(missing_ok=True)
        if begun.has_head:
            self._file.cut(kept.size, kept.crc)
        else:
            self._file.cut(0, 0)
            self._file.append(self._layout.head)
        self._written = kept.written
        self.begun = begun

    def _put_aside(self, size: int) -> None:
        """Keep the file unchanged under another name, and continue with a copy of `size` bytes."""
        try:
            file, self.aside = put_aside(self._file, size)
        except OSError as error:
            raise RunFailed(
                f"{self.path} is damaged, and what is sound of it can't be copied"
                f" ({error.strerror}): make room and try again"
            ) from error
        self._file.close()
        self._file = file
        if self.begun is not None:
            self.begun.fd = file.fd

    def _unusable(self, error: OSError) -> FlockError:
        return FlockError(
            f"output {self.directory} can't be written ({error.strerror}): name another directory"
        )

    def _complete(self) -> None:
        if self._lost:
            return self._let_go()
        if self._replaces and not self._written.chunks:
            return self._remove()
        part = self.directory / PART_FILE
        try:
            self.take_place()
            self._file.check(thorough=True)
            self._reserve.free()
            self._file.append(self._layout.tail(self._written, self._file.size, self._file.crc))
            self._file.sync()
            # Atomically, and after everything else is on the disk: its presence says so.
            with part.open("w", encoding="utf-8") as file:
                file.write(self._metadata_text())
                file.flush()
                os.fsync(file.fileno())
            part.replace(self.directory / METADATA_FILE)
        except LostError as error:
            raise self._lose(error) from error
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
        """Make the added messages count, and end the chunk if it is full."""
        self._chunk.take()
        if self._chunk.size >= self._limit:
            self.flush()

    def _lose(self, error: LostError) -> RunFailed:
        """Do as `_refuse`: the file was removed or changed, and this writer does not touch it."""
        self._lost = True
        return self._refuse(
            f"recording to {self.path} failed: {error.strerror}; nothing more is recorded: see that"
            " no other program touches the bag of a flight, and fly again"
        )

    def _refuse(self, reason: str) -> RunFailed:
        """Make every later `write` and `flush` raise the returned failure; no cost until then."""
        self._failure = RunFailed(reason)
        self._limit = 0
        return self._failure

    def _refuse_closed(self) -> None:
        self._refuse(f"the bag {self.directory} is closed: nothing can be written to it")
