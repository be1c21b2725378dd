# SPDX-License-Identifier: Apache-2.0
"""Reading a bag: ours or anybody's MCAP, complete or torn, with bounded memory."""

import re
from collections import Counter
from collections.abc import Collection, Iterator
from pathlib import Path
from types import TracebackType

from mcap.records import Channel

from flock_sim.bag.mcap_file import McapFile
from flock_sim.bag.rosbag2_metadata import METADATA_FILE
from flock_sim.errors import FlockError


class BagReader:
    """Reads a bag directory, or one .mcap file.

        with BagReader("runs/demo") as bag:
            configuration = bag.metadata("flock")
            for topic, log_time, cdr in bag.messages(start=bag.last_time):
                ...

    Attributes: `topics` gives the type of each topic by name, `channels` its MCAP channel, with the
    encoding and what the recorder said of it; `message_counts` the number of
    messages of each topic, or None where a file has no summary; `last_time` the latest log time
    in ns, or None without messages; `missing` is None, or one line on what a bag that was cut
    short or damaged lacks: what is whole of it is read.

    Opening raises FlockError for what is not a bag. Memory: one chunk.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self._files = [McapFile(file) for file in _recordings(self.path)]
        self.topics: dict[str, str] = {}
        self.channels: dict[str, Channel] = {}
        for file in self._files:
            self.topics.update(file.topics)
            self.channels.update(file.channels)
        self.message_counts = self._count()
        times = [file.last_time for file in self._files if file.last_time is not None]
        self.last_time = max(times, default=None)
        self.missing = self._missing()

    def metadata(self, name: str) -> dict[str, str]:
        """Return the MCAP metadata record of that name; raises FlockError where there is none."""
        for file in self._files:
            if name in file.metadata:
                return dict(file.metadata[name])
        raise FlockError(f"{self.path} has no metadata record {name!r}: it is no run of Flock")

    def messages(
        self,
        topics: Collection[str] | None = None,
        start: int | None = None,
        end: int | None = None,
    ) -> Iterator[tuple[str, int, bytes]]:
        """Yield the messages (topic, log time in ns, serialised data) in the order of the file.

        Only of `topics`, and with start <= log time < end, where these are given; of a bag with
        a summary, only the chunks that hold such messages are read.

        Raises FlockError when it comes to a damaged chunk.
        """
        for file in self._files:
            yield from file.messages(topics, start, end)

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

    def _missing(self) -> str | None:
        parts = [f"{file.path.name}: {file.missing}" for file in self._files if file.missing]
        if self.path.is_dir() and not (self.path / METADATA_FILE).exists():
            parts.insert(0, f"no {METADATA_FILE} (the recording was cut short)")
        return f"{self.path} is not complete: {'; '.join(parts)}" if parts else None


def _recordings(path: Path) -> list[Path]:
    """Find the .mcap files of a bag in order; raises FlockError where there is none."""
    try:
        if not path.is_dir():
            return [path]
        entries = list(path.iterdir())
    except OSError as error:
        raise FlockError(f"{path} can't be read: {error.strerror}") from error
    files = [entry for entry in entries if entry.suffix == ".mcap"]
    if not files:
        why = "there is no .mcap file in it"
        if any(entry.suffix == ".db3" for entry in entries):
            why += ", but SQLite; ros2 bag convert makes MCAP of it"
        raise FlockError(f"{path} is not a bag that can be read: {why}")
    # rosbag2 splits a long bag into NAME_0.mcap, NAME_1.mcap, ... NAME_10.mcap
    return sorted(files, key=lambda file: (_number(file.stem), file.name))


def _number(stem: str) -> int:
    match = re.search(r"_(\d+)$", stem)
    return int(match[1]) if match else 0
