# SPDX-License-Identifier: Apache-2.0
"""The writer of a rosbag2 bag: the recorder's hot path, safe against kill -9 and a full disk."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

from mcap.records import Metadata
from zstandard import ZstdCompressor

from flock_sim.bag import limits
from flock_sim.bag.chunk import OpenChunk
from flock_sim.bag.definitions import Definition, installed_definition
from flock_sim.bag.file_sections import Layout
from flock_sim.bag.topic import Topic
from flock_sim.bag.writing.bag_on_disk import BagOnDisk
from flock_sim.bag.writing.partial_bag import PartialBag
from flock_sim.errors import RunFailed


class BagWriter:
    """Writes one bag directory: an MCAP file, and metadata.yaml when the bag is complete.

        with BagWriter("runs/demo", topics, {"flock": configuration}) as bag:
            bag.write("/flock/bird_01/state", log_time, cdr)
            bag.flush()  # safe against kill -9 from here on

    With `resume`, it continues a bag after a kill, a full disk, a power cut, or `close`, behind its
    last whole chunk. `begun` then gives access to the whole chunks, and is None otherwise.

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
        self._disk = BagOnDisk(
            Path(directory),
            Layout(topics, define, metadata),
            custom_data or {},
            resume=resume,
            replace=replace,
        )
        self._chunk = OpenChunk([topic.name for topic in topics])
        self._limit = chunk_size
        self._compressor = ZstdCompressor(level=compression_level)
        self._failure: RunFailed | None = None
        self._closed = False

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
        self._chunk.drop_incomplete()
        published = log_time if publish_time is None else publish_time
        self._chunk.add(topic, log_time, data, published, sequence)
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
        Raises RunFailed if the chunk can't be stored, or is larger than readers accept: it is then
        left out completely.
        """
        if self._failure is not None:
            self._chunk.clear()
            raise self._failure
        self._chunk.drop_incomplete()
        if not self._chunk.size:
            return
        self._check_size()
        sealed = self._chunk.seal(self._disk.size, self._compressor)
        self._chunk.clear()
        with self._keeping_failure():
            self._disk.append(sealed)

    def _check_size(self) -> None:
        """Raise RunFailed if readers would refuse the chunk. Its messages are then left out."""
        size = self._chunk.size
        if size <= limits.LARGEST_MESSAGE:
            return
        largest = self._chunk.largest
        beyond = ""
        if size > limits.LARGEST_CHUNK:
            beyond = limits.beyond(size, limits.LARGEST_CHUNK, "bytes of one recorded step")
        elif largest > limits.LARGEST_MESSAGE:
            beyond = limits.beyond(largest, limits.LARGEST_MESSAGE, "bytes of one message")
        if beyond:
            self._chunk.clear()
            with self._keeping_failure():
                raise RunFailed(
                    f"recording to {self.path} failed: it would get {beyond}; fly fewer members"
                )

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write a named record to the file, behind its last chunk; raises RunFailed as `flush`."""
        with self._keeping_failure():
            if self._failure is not None:
                raise self._failure
            self._disk.append_metadata(Metadata(name=name, metadata=dict(values)))

    def check(self) -> None:
        """Raise RunFailed if the file was removed or changed, without reading unchanged content."""
        if not self._closed:
            with self._keeping_failure():
                self._disk.check()

    def cut_back(self, chunks: int, *, keep_aside: bool = False) -> None:
        """Keep only the first `chunks` chunks of a resumed bag. Call it before any other write.

        `keep_aside`: the complete file stays under another name. Raises FlockError if the bag is
        damaged or can't be read or written.
        """
        self._disk.cut_back(chunks, keep_aside=keep_aside)

    def take_place(self) -> None:
        """Remove the bag that this one replaces, and take its place; raises RunFailed."""
        if self._disk.replaces:
            self.check()
            with self._keeping_failure():
                self._disk.take_place()

    def discard(self) -> None:
        """Remove the bag; a bag that it was to replace stays."""
        if not self._closed:
            self._closed = True
            self._disk.remove()
            self._refuse_closed()

    def leave(self) -> None:
        """Flush, and close the file without completing the bag, which can be resumed later."""
        self._end(self._disk.let_go)

    def close(self, metadata: Mapping[str, Mapping[str, str]] | None = None) -> None:
        """Flush, write the summary, and then metadata.yaml; a second call does nothing.

        `metadata` are named records at the end of the file, which are dropped when it is resumed.
        Raises RunFailed if the last messages or the summary can't be stored. An error that an
        earlier `flush` raised is not raised again.
        """
        self._end(lambda: self._disk.complete(metadata or {}))

    def _end(self, how: Callable[[], None]) -> None:
        """Flush and call `how` to end the bag, once; nothing can be written from then on."""
        if self._closed:
            return
        self._closed = True
        try:
            if self._failure is None:
                self.flush()
        finally:
            with self._keeping_failure():
                how()
            self._refuse_closed()

    def __enter__(self) -> "BagWriter":
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    @property
    def path(self) -> Path:
        """The file of the bag. Its name changes when the bag takes the place of another one."""
        return self._disk.path

    @property
    def begun(self) -> PartialBag | None:
        """The whole chunks of a resumed bag; None for a new one."""
        return self._disk.begun

    @property
    def metadata(self) -> Mapping[str, Mapping[str, str]]:
        """The records that `add_metadata` has written, by name, those of a resumed bag included."""
        return self._disk.written.metadata

    @property
    def aside(self) -> Path | None:
        """The damaged file that was kept under another name; None without damage."""
        return self._disk.aside

    @property
    def replaces(self) -> bool:
        """Whether this bag has still to replace another one."""
        return self._disk.replaces

    @property
    def writable(self) -> bool:
        """Whether anything can be written: the bag is not closed, and nothing has failed."""
        return self._failure is None

    @property
    def closed(self) -> bool:
        """Whether the bag was closed, left or discarded."""
        return self._closed

    def count(self, topic: int) -> int:
        """Return the number of messages of a topic, by its index from 0, in chunks on disk."""
        return self._disk.written.counts.get(topic + 1, 0)

    @property
    def messages_safe(self) -> int:
        """Number of messages that are safe after a kill -9 of this process."""
        return self._disk.written.messages

    @property
    def chunks_safe(self) -> int:
        """Number of chunks that are safe after a kill -9 of this process; `flush` may add one."""
        return self._disk.written.chunks

    def _take(self) -> None:
        """Make the added messages count, and end the chunk if it is full."""
        self._chunk.take()
        if self._chunk.size >= self._limit:
            self.flush()

    @contextmanager
    def _keeping_failure(self) -> Iterator[None]:
        """If RunFailed is raised, make every later `write` and `flush` raise it, too."""
        try:
            yield
        except RunFailed as error:
            self._refuse(error)
            raise

    def _refuse(self, failure: RunFailed) -> None:
        """Make every later `write` and `flush` raise `failure`; no cost until then."""
        self._failure = failure
        self._limit = 0

    def _refuse_closed(self) -> None:
        directory = self._disk.directory
        self._refuse(RunFailed(f"the bag {directory} is closed: nothing can be written to it"))
