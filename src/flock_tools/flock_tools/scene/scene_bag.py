# SPDX-License-Identifier: Apache-2.0
"""The scene of a recorded flight as a bag of its own, for viewers that open files."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from tempfile import TemporaryDirectory

from flock_sim import __version__
from flock_sim.bag.definitions import copied_definition
from flock_sim.bag.directory import bag_files
from flock_sim.bag.topic import Topic
from flock_sim.bag.writing.writer import BagWriter
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.errors import FlockError, RunFailed
from flock_sim.messages.topics import CLOCK_TOPIC, NAMESPACE
from flock_sim.messages.types import BILLION, Time
from flock_sim.physics.arrays import FloatArray
from flock_sim.recording.output_directory import Output
from flock_sim.recording.run import Run
from flock_tools.scene import messages
from flock_tools.scene.frame import ODOMETRY_DEPTH, TOPICS, TRAIL, Frame, odometry_topic
from flock_tools.scene.snapshot import Snapshot

MOST_PICTURES = 300
"""Largest usual number of pictures of a flight, not counting the last one."""

CHUNK, LEVEL = 8 << 20, 6
"""Size of a chunk, in bytes, and level of its compression: a chunk holds several pictures, which
have most of their bytes in common."""

RECORD = "flock_scene"
"""The metadata record that tells what is shown. Bags of flights have another one."""


@dataclass(frozen=True)
class Pictures:
    """The recorded steps that are shown: every `stride`-th one, and the last one."""

    stride: int
    """Distance between two pictures, in steps."""
    last: int
    rate: float
    """Number of pictures per second of simulated time."""

    @classmethod
    def of(cls, configuration: FlockConfiguration, last: int, rate: float | None) -> Pictures:
        """Return pictures up to the step `last`, at most `rate` per second of simulated time.

        There are no more than were recorded. A rate of None gives at most MOST_PICTURES.
        """
        every = configuration.record_every
        row = every * configuration.dt * configuration.second
        rows = -(-last // (every * MOST_PICTURES)) if rate is None else round(1.0 / (rate * row))
        stride = max(1, min(rows, max(1, last // every)))
        return cls(stride * every, last, 1.0 / (stride * row))

    @property
    def steps(self) -> range:
        """The steps that are shown, without the last one if it is no multiple of `stride`."""
        return range(0, self.last + 1, self.stride)

    def __len__(self) -> int:
        return len(self.steps) + (self.last % self.stride > 0)


def write_scene(
    run: Run,
    m: int,
    pictures: Pictures,
    output: Output,
    shown: Callable[[float], None],
    odometry: bool = False,
) -> int:
    """Write the scene of the member with index `m` to `output`; return the size in bytes.

    The bag is written beside `output`, and takes its place once it is complete. `shown` is called
    with 1 after each picture. With `odometry`, the bag has the Odometry of each bird, too.
    Raises FlockError if this is impossible, RunFailed for a full disk.
    """
    place, source = output.path.resolve(), run.path.resolve()
    if place in (source, source.parent):  # the flight may be named by its file
        raise FlockError(f"--output {output.path}: is the flight itself; name another directory")
    try:
        with TemporaryDirectory(prefix=f".{place.name}-", dir=place.parent) as scratch:
            written = Path(scratch) / place.name
            size = _write(run, m, pictures, written, shown, odometry)
            output.check()
            for entry in bag_files(place):
                entry.unlink()
            written.rename(place)
    except OSError as error:
        raise FlockError(f"--output {output.path}: can't be written: {error.strerror}") from error
    except RunFailed as error:
        cause = error.__cause__
        reason = cause.strerror if isinstance(cause, OSError) else str(error)
        raise RunFailed(f"--output {output.path}: can't be written: {reason}") from error
    return size


def _write(
    run: Run,
    m: int,
    pictures: Pictures,
    directory: Path,
    shown: Callable[[float], None],
    odometry: bool,
) -> int:
    """Write a bag to a new `directory`; return its size in bytes."""
    record = {"member": str(m + 1), "flock_version": __version__}
    topics = [Topic(CLOCK_TOPIC, Time.TYPE)]
    topics += [Topic(name, topic.type, depth=topic.depth) for name, topic in TOPICS.items()]
    birds = range(1, run.configuration.birds + 1) if odometry else ()
    odometry_of = {bird: f"{NAMESPACE}/{odometry_topic(bird)}" for bird in birds}
    topics += [
        Topic(name, messages.ODOMETRY, depth=ODOMETRY_DEPTH) for name in odometry_of.values()
    ]
    with BagWriter(
        directory,
        topics,
        {RECORD: record},
        chunk_size=CHUNK,
        compression_level=LEVEL,
        define=copied_definition,
    ) as bag:
        for frame in _frames(run, m, pictures, odometry):
            told = [(CLOCK_TOPIC, Time.at(frame.stamp).encode())]
            told += [(name, topic.message(frame)) for name, topic in TOPICS.items()]
            told += [(odometry_of[bird], frame.odometry(bird)) for bird in frame.birds]
            bag.write_together((name, frame.stamp, data) for name, data in told)
            shown(1.0)
    return sum(entry.stat().st_size for entry in bag_files(directory))


def _frames(run: Run, m: int, pictures: Pictures, odometry: bool) -> Iterator[Frame]:
    """Yield the pictures of the member with index `m`."""
    configuration = run.configuration
    steps = pictures.steps
    states = run.snapshots_at(steps)
    if pictures.last not in steps:
        states = chain(states, [run.at()])
    trail: deque[FloatArray] = deque(maxlen=TRAIL)
    known: list[bool] | None = None
    for state in states:
        stamp = divmod(configuration.stamp(state.step), BILLION)
        snapshot = Snapshot.of(configuration, state, configuration.span_ratio, m, stamp)
        before, known = known, snapshot.known.tolist()
        yield Frame(snapshot, list(trail), anew=known != before, odometry=odometry)
        trail.append(snapshot.along)
