# SPDX-License-Identifier: Apache-2.0
"""Reading a bag: Flock's or any other MCAP, complete or torn, with bounded memory."""

from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from types import TracebackType

from mcap.records import Channel

from flock_sim.bag.limits import LimitError
from flock_sim.bag.reading.compression import unpacked_message
from flock_sim.bag.reading.listing import listing, packed_as_recorded
from flock_sim.bag.reading.mcap_file import McapFile, Part, Recorded, Stream
from flock_sim.bag.reading.time_order import KeptSize, in_time_order, latest
from flock_sim.bag.records import DamagedError
from flock_sim.errors import FlockError

__all__ = ["BagReader", "Recorded", "Stream"]

_SMALLER = "read fewer topics, or take another copy of the bag"


class BagReader:
    """Reads a bag directory, or one .mcap file.

        with BagReader("runs/demo") as bag:
            configuration = bag.metadata("flock")
            for topic, log_time, cdr in bag.messages(start=bag.last_time):
                ...

    Attributes: `types` are the types that the bag defines; a torn bag may have no topics of them.
    `topics` gives the type of each topic by name. `streams` gives all MCAP channels, with the
    recorder's metadata, by topic, type and encoding. `message_counts` is the number of messages of
    each topic, or None if a file has no summary. `first_time` and `last_time` are the earliest and
    the latest log time in ns, or None without messages. `missing` is None, or one line on the
    missing parts of a bag that was cut short or damaged; its whole parts are read. `left_out` are
    the names of recordings in its directory that its metadata.yaml does not list.

    Files and messages that rosbag2 has compressed are read like uncompressed ones.

    Opening raises FlockError if the path is not a bag. Memory: one chunk.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        listed = listing(self.path)
        self.left_out = listed.left_out
        self._files, unreadable = _opened(listed.files)
        self._packed = listed.packed_messages or any(
            packed_as_recorded(self.path, file.metadata.get("rosbag2", {})) for file in self._files
        )
        self.types: set[str] = set().union(*(file.types for file in self._files))
        self.topics: dict[str, str] = {}
        self.streams: dict[Stream, list[Channel]] = {}
        for file in self._files:
            self.topics.update(file.topics)
            for stream, channels in file.streams.items():
                self.streams.setdefault(stream, []).extend(channels)
        self.message_counts = self._count()
        firsts = [file.first_time for file in self._files if file.first_time is not None]
        self.first_time = min(firsts, default=None)
        times = [file.last_time for file in self._files if file.last_time is not None]
        self.last_time = max(times, default=None)
        self.missing = self._missing([*listed.missing, *unreadable])

    def metadata(self, name: str) -> dict[str, str]:
        """Return the MCAP metadata record called `name`; raises FlockError if there is none."""
        if name in self.records:
            return self.records[name]
        raise FlockError(f"{self.path} has no metadata record {name!r}: it is not a run of Flock")

    @property
    def records(self) -> dict[str, dict[str, str]]:
        """The MCAP metadata records by name; of equal names, that of the first file."""
        return {
            name: dict(record)
            for file in reversed(self._files)
            for name, record in file.metadata.items()
        }

    def messages(
        self,
        topics: Collection[str] | None = None,
        start: int | None = None,
        end: int | None = None,
    ) -> Iterator[tuple[str, int, bytes]]:
        """Yield the messages (topic, log time in ns, serialised data) in the order of the file.

        Only messages of `topics` with start <= log time < end are yielded, if these are given. In a
        bag with a summary, only the chunks with such messages are read.

        Raises FlockError when it reaches a damaged chunk.
        """
        for file in self._files:
            messages = file.messages(topics, start, end)
            yield from self._unpacked(messages) if self._packed else messages

    def by_time(
        self, streams: Collection[Stream], start: int | None = None, end: int | None = None
    ) -> Iterator[Recorded]:
        """Yield the messages of `streams` as `messages` does, but ordered by log time.

        Messages with equal times keep the order of the bag. Memory: the chunks that overlap in
        time.
        """
        messages = self._bounded(in_time_order(lambda: self._parts(streams, start, end)))
        return self._unpacked(messages) if self._packed else messages

    def latest(self, wanted: Mapping[Stream, int], end: int) -> list[Recorded]:
        """Return the last messages of each topic before `end`, in ns, ordered by log time.

        `wanted` gives their number for each stream. For several streams of one topic, the largest
        of these numbers is that of the topic.
        """
        many: dict[str, int] = {}
        for stream, count in wanted.items():
            many[stream.topic] = max(count, many.get(stream.topic, 0))
        try:
            messages = latest(self._parts(wanted, None, end), many)
            return self._unpacked_list(messages) if self._packed else messages
        except LimitError as error:
            raise FlockError(f"{self.path} {error}: {_SMALLER}") from error
        except DamagedError as error:
            raise self._damaged(error) from error

    def _parts(
        self, streams: Collection[Stream], start: int | None, end: int | None
    ) -> Iterator[tuple[int, Part]]:
        for number, file in enumerate(self._files):
            for part in file.parts(streams, start, end):
                yield number, part

    def _unpacked(self, messages: Iterator[Recorded]) -> Iterator[Recorded]:
        """Decompress the data of messages; raises FlockError if one is damaged."""
        try:
            for topic, time, data in messages:
                yield topic, time, unpacked_message(data)
        except DamagedError as error:
            raise self._damaged(error) from error

    def _unpacked_list(self, messages: list[Recorded]) -> list[Recorded]:
        """Decompress messages that are kept together. Raises DamagedError and LimitError."""
        kept = KeptSize()
        unpacked: list[Recorded] = []
        for topic, time, data in messages:
            unpacked.append((topic, time, unpacked_message(data)))
            kept.add(unpacked[-1])
        return unpacked

    def _damaged(self, error: DamagedError) -> FlockError:
        return FlockError(f"{self.path} is damaged ({error}): take another copy of the bag")

    def _bounded(self, messages: Iterator[Recorded]) -> Iterator[Recorded]:
        """Yield messages; raises FlockError, with the path, where they exceed a limit."""
        try:
            yield from messages
        except LimitError as error:
            raise FlockError(f"{self.path} {error}: {_SMALLER}") from error

    def salvage(self, broken: list[str], cut: list[str] | None = None) -> Iterator[Recorded]:
        """Yield messages as `messages` does, of all chunks with a correct CRC, also after damage.

        It reads the whole bag, and adds a line to `broken` for each damaged place. With `cut`, it
        also yields the whole messages of a chunk that the end of a file cuts, to which no CRC
        applies, and adds a line to `cut` for each such chunk.
        """
        for file in self._files:
            messages = file.salvage(broken, cut)
            yield from self._salvaged(messages, broken) if self._packed else messages
            if not broken and not file.crc_fits():
                broken.append(
                    f"{file.path} is damaged, though its messages are not: its CRC differs"
                )

    def _salvaged(self, messages: Iterator[Recorded], broken: list[str]) -> Iterator[Recorded]:
        """Decompress the data of messages, and leave out damaged ones."""
        for topic, time, data in messages:
            try:
                yield topic, time, unpacked_message(data)
            except DamagedError as error:
                broken.append(f"{self.path} is damaged at {time} ns on {topic} ({error})")

    def close(self) -> None:
        """Close the files; a second call does nothing."""
        for file in self._files:
            file.close()

    def __enter__(self) -> "BagReader":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _count(self) -> dict[str, int] | None:
        total = Counter(dict.fromkeys(self.topics, 0))
        for file in self._files:
            if file.message_counts is None:
                return None
            total.update(file.message_counts)
        return dict(total)

    def _missing(self, of_the_bag: Collection[str]) -> str | None:
        of_files = [f"{file.path.name}: {file.missing}" for file in self._files if file.missing]
        parts = [*of_the_bag, *of_files]
        return f"{self.path} is not complete: {'; '.join(parts)}" if parts else None


def _opened(paths: Sequence[Path]) -> tuple[list[McapFile], list[str]]:
    """Open the files of a bag; return those that can be read, and the reasons for the others.

    Raises FlockError if no file can be read.
    """
    files: list[McapFile] = []
    reasons: list[str] = []
    for path in paths:
        try:
            files.append(McapFile(path))
        except FlockError as error:
            if path is paths[-1] and not files:
                raise
            reasons.append(path.name + str(error).removeprefix(str(path)).partition(":")[0])
    return files, reasons
