# SPDX-License-Identifier: Apache-2.0
"""Reads randomly changed bags with everything that reads bags, in a process of limited memory.

    python -m support.read_bags DIRECTORY FIRST_SEED COUNT

It prints a line for each exception other than FlockError, and exits with status 1 after any.
"""

from __future__ import annotations

import resource
import sys
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from itertools import islice
from pathlib import Path
from random import Random

import yaml
import zstandard
from mcap.writer import CompressionType, Writer

from flock_sim.bag.reading.reader import BagReader
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.errors import FlockError
from flock_sim.recording.run import Run
from flock_tools.playback.topics import select
from flock_tools.runs import dataset
from flock_tools.runs.replay import latched_before
from support import random_bags
from support.flights import record
from support.foreign import STRING, profile, word, write_metadata

MEMORY = 2**30
"""Memory that the readers may use beyond that of the imported modules, in bytes."""

OFTEN = 10_000
"""Messages that are read of each bag: a changed bag may repeat them."""

ROS_TYPES = ("builtin_interfaces", "std_msgs", "flock_interfaces", "rosgraph_msgs")
"""Packages whose modules may be imported for the types that a bag names."""


def genuine_bags(directory: Path) -> list[list[random_bags.Record]]:
    """Return the records of a flight, of its live form, and of foreign bags."""
    short = FlockConfiguration(birds=3, t_max=3.0, record_every=1)
    files = [
        *record(directory / "flight", short).glob("*.mcap"),
        *record(directory / "live", short, grants=True).glob("*.mcap"),
    ]
    for compression in CompressionType:
        files.append(_foreign(directory / f"{compression.name}.mcap", compression))
    return [random_bags.split(file.read_bytes()) for file in files]


def _foreign(path: Path, compression: CompressionType) -> Path:
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=200, compression=compression)
        writer.start("ros2", "theirs")
        writer.add_metadata("rosbag2", {"serialized_metadata": yaml.safe_dump({"a": 1})})
        schema = writer.register_schema(STRING, "ros2msg", b"string data\n")
        for topic in ("/words", "/latched"):
            offered = profile(durability="transient_local" if topic == "/latched" else "volatile")
            channel = writer.register_channel(
                topic, "cdr", schema, {"offered_qos_profiles": offered}
            )
            for time in range(10):
                writer.add_message(channel, time, zstandard.compress(word("a")), time)
        writer.finish()
    return path


def _bag_is_read(path: Path) -> None:
    with BagReader(path) as bag:
        assert isinstance(bag.records, dict)
        streams = list(bag.streams)
        reads: list[Callable[[], object]] = [
            lambda: _some(bag.messages()),
            lambda: _some(bag.messages(["/words"], 2, 5)),
            lambda: _some(bag.by_time(streams)),
            lambda: bag.latest(dict.fromkeys(streams, 3), 2**64),
            lambda: _some(bag.salvage([], [])),
            lambda: latched_before(bag, select(bag), 5),
        ]
        for read in reads:
            with _refused():
                read()


def _run_is_read(path: Path) -> None:
    with Run(path) as run:
        reads: list[Callable[[], object]] = [
            lambda: _some(run.snapshots()),
            lambda: _some(run.ages()),
            run.wings,
            run.metrics,
            run.verdicts,
            lambda: run.time_means(run.at().time),
            lambda: (run.real_time_factor, run.own_parts, run.machines, run.state_digest),
            lambda: dataset.load(path),
        ]
        for read in reads:
            with _refused():
                read()


def _some(messages: Iterator[object]) -> None:
    for _ in islice(messages, OFTEN):
        pass


@contextmanager
def _refused() -> Iterator[None]:
    with suppress(FlockError):
        yield


def _write(directory: Path, content: bytes, random: Random) -> Path:
    """Write a file alone, or in a bag, with rosbag2's compression of files or messages or none."""
    path = directory / "bag" / "bag_0.mcap"
    path.parent.mkdir(exist_ok=True)
    for old in path.parent.iterdir():
        old.unlink()
    kind = random.randrange(6)
    if kind == 0:
        path = path.with_name(f"{path.name}.zstd")
        content = zstandard.compress(content)
    path.write_bytes(content)
    if kind < 3:
        mode = ("FILE", "MESSAGE", "")[kind]
        write_metadata(path.parent, [path.name], mode)
    return path.parent if kind < 4 else path


def main(directory: Path, first: int, count: int) -> int:
    """Read `count` bags; return the exit status."""
    bags = genuine_bags(directory)
    for path in directory.glob("*.mcap"):  # the modules that are imported for genuine bags
        with _refused():
            _bag_is_read(path)
    _run_is_read(directory / "flight")
    used = int(Path("/proc/self/statm").read_text(encoding="utf-8").split()[0])
    modules = set(sys.modules)
    most = used * resource.getpagesize() + MEMORY
    resource.setrlimit(resource.RLIMIT_AS, (most, most))
    failed = 0
    for seed in range(first, first + count):
        random = Random(seed)
        path = _write(directory, random_bags.mutated(random.choice(bags), random), random)
        for read in (_bag_is_read, _run_is_read):
            try:
                with _refused():
                    read(path)
            except Exception as error:
                failed += 1
                place = traceback.extract_tb(error.__traceback__)[-1]
                print(f"seed {seed}: {read.__name__}: {error!r:.300} at {place}", flush=True)
    more = {name for name in set(sys.modules) - modules if name.partition(".")[0] not in ROS_TYPES}
    if more:
        failed += 1
        print(f"imported: {sorted(more)}")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3])))
