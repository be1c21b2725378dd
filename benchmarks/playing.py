# SPDX-License-Identifier: Apache-2.0
"""Does `play` keep time, and does it find its place in a large bag? Measured by who listens.

    ./flock python benchmarks/playing.py [--gigabytes 1] [--seconds 5]

How far the spacing of messages is off what was recorded, at rates 1, 10 and 0.5; how long it takes
from asking for a moment until its message is heard; how much memory the player has; how much
processor time the opening of a bag of 300 MB takes, in chunks of 10 kB and of 4 MB. Exit status 1
if a spacing is off by 5 ms, a seek takes 100 ms or brings another message, or memory grows. The
bags are made in a temporary directory, and are removed.
"""

from __future__ import annotations

import argparse
import gc
import os
import random
import subprocess
import sys
import tempfile
import time
from base64 import b64encode
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from statistics import median
from typing import Any

import rclpy
from builtin_interfaces.msg import Time as Stamp
from mcap.writer import CompressionType, Writer
from memory import resident
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.serialization import serialize_message
from std_msgs.msg import String

from flock_interfaces import srv
from flock_sim.bag.reading.reader import BagReader
from flock_sim.bag.topic import Topic
from flock_sim.bag.writing.writer import BagWriter
from flock_sim.ros.discovery import held_domain, prepare_discovery, quiet_domains
from flock_sim.ros.process import ros_context

MILLISECOND = 1_000_000
SPACING = 20 * MILLISECOND
SIZE = 16_384
SEEKS = 50
TOPIC = "/said"


class Listener:
    """Hears what is played, with the time at which it came."""

    def __init__(self, context: Any) -> None:
        self.node = Node("listener", context=context)
        self.heard: list[tuple[float, int]] = []  # when, and the number of the message
        self.node.create_subscription(String, TOPIC, self._hear, 1000)
        self._executor = SingleThreadedExecutor(context=context)
        self._executor.add_node(self.node)

    def _hear(self, message: String) -> None:
        self.heard.append((time.perf_counter(), int(message.data[:9])))

    def until(self, condition: Callable[[], Any]) -> None:
        deadline = time.monotonic() + 120.0
        while not condition():
            if time.monotonic() > deadline:
                raise SystemExit("error: the player does not answer")
            self._executor.spin_once(timeout_sec=0.01)

    def ask(self, kind: Any, name: str, **request: Any) -> Any:
        client = self.node.create_client(kind, f"/flock/player/{name}")
        self.until(client.service_is_ready)
        future = client.call_async(kind.Request(**request))
        self.until(future.done)
        self.node.destroy_client(client)
        return future.result()


def write(directory: Path, messages: int, size: int) -> None:
    """Write a bag of numbered messages that take some `size` bytes each, compressed."""
    with BagWriter(directory, [Topic(TOPIC, "std_msgs/msg/String")], {}) as bag:
        for k in range(messages):
            said = String(data=f"{k:09}" + b64encode(os.urandom(size)).decode())
            bag.write(TOPIC, k * SPACING, serialize_message(said))


@contextmanager
def playing(*arguments: object) -> Iterator[subprocess.Popen[bytes]]:
    command = [sys.executable, "-P", "-m", "flock_tools.commands.play", *map(str, arguments)]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL) as player:
        try:
            yield player
        finally:
            player.terminate()


def keeps_time(listener: Listener, bag: Path, rate: float, seconds: float) -> bool:
    listener.heard.clear()
    with playing(bag, "--rate", rate, "--duration", seconds * rate) as player:
        listener.until(lambda: player.poll() is not None)
    due = SPACING / 1e9 / rate
    times, numbers = zip(*listener.heard)
    off = [1e3 * abs(later - one - due) for one, later in zip(times, times[1:])]
    late = [1e3 * (at - times[0] - k * due) for k, at in enumerate(times)]
    whole = list(numbers) == list(range(len(numbers)))
    ordered = sorted(off)
    print(
        f"rate {rate:<4g} {len(times):5} messages every {1e3 * due:5.1f} ms: spacing off by "
        f"{median(off):.2f} ms (median), {ordered[int(0.99 * len(off))]:.2f} ms (99 %), "
        f"{ordered[-1]:.2f} ms (most); off the schedule by {max(map(abs, late)):.2f} ms at most; "
        f"{'each once, in order' if whole else 'NOT each once, in order'}"
    )
    return whole and ordered[-1] < 5.0


def finds_its_place(listener: Listener, bag: Path, messages: int) -> bool:
    took, right = [], True
    with playing(bag, "--paused") as player:
        listener.ask(srv.IsPaused, "is_paused")
        listener.until(lambda: listener.node.count_publishers(TOPIC))
        listener.ask(srv.PlayNext, "play_next")
        before = resident(player.pid)
        seek = listener.node.create_client(srv.Seek, "/flock/player/seek")
        after = listener.node.create_client(srv.PlayNext, "/flock/player/play_next")
        listener.until(lambda: seek.service_is_ready() and after.service_is_ready())
        for _ in range(SEEKS):
            number = random.randrange(messages)
            listener.heard.clear()
            second, rest = divmod(number * SPACING, 10**9)
            begun = time.perf_counter()
            found = seek.call_async(srv.Seek.Request(time=Stamp(sec=second, nanosec=rest)))
            listener.until(found.done)
            after.call_async(srv.PlayNext.Request())
            listener.until(lambda: listener.heard)
            at, heard = listener.heard[0]
            took.append(1e3 * (at - begun))
            right &= heard == number
        sought = resident(player.pid)
        listener.ask(srv.SetRate, "set_rate", rate=100.0)
        listener.ask(srv.Resume, "resume")
        most, until = 0.0, time.monotonic() + 5.0
        while time.monotonic() < until and player.poll() is None:
            listener.until(lambda: True)
            most = max(most, resident(player.pid))
    print(
        f"{SEEKS} seeks until the message is heard: {median(took):.1f} ms (median), "
        f"{max(took):.1f} ms (most); {'all right' if right else 'NOT all right'}; "
        f"memory {before:.0f} MiB, {sought:.0f} MiB after them, {most:.0f} MiB at rate 100"
    )
    return right and max(took) < 100.0 and most < before + 64.0


def opens(path: Path, chunk: int) -> None:
    """Write a bag of 300 MB in chunks of `chunk` bytes, and measure how it is opened and sought."""
    data = serialize_message(String(data="-" * 980))
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=chunk, compression=CompressionType.NONE)
        writer.start("ros2", "benchmark")
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data\n")
        channels = [writer.register_channel(f"/t{k}", "cdr", schema) for k in range(10)]
        for k in range(300_000):
            writer.add_message(channels[k % 10], k * MILLISECOND, data, k * MILLISECOND)
        writer.finish()
    begun = time.process_time()
    with BagReader(path) as bag:
        opened = time.process_time()
        next(bag.by_time(bag.streams, 299_000 * MILLISECOND))
        sought = time.process_time()
    print(
        f"chunks of {chunk} bytes: {opened - begun:.3f} s to open, {sought - opened:.3f} s to seek"
    )


def main() -> int:
    """Make bags, play them, and say what was heard."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--gigabytes", type=float, default=1.0)
    parser.add_argument("--seconds", type=float, default=5.0)
    options = parser.parse_args()
    with held_domain(quiet_domains()) as domain, tempfile.TemporaryDirectory() as directory:
        os.environ["ROS_DOMAIN_ID"] = str(domain)
        prepare_discovery()
        context = ros_context([])
        try:
            listener = Listener(context)
            short, large = Path(directory) / "short", Path(directory) / "large"
            write(short, int(12 * options.seconds * 1e9 / SPACING), 64)
            gc.freeze()  # as the player does
            good = [keeps_time(listener, short, rate, options.seconds) for rate in (1.0, 10.0, 0.5)]
            messages = int(options.gigabytes * 1e9 / SIZE)
            write(large, messages, SIZE)
            size = sum(file.stat().st_size for file in large.iterdir())
            print(f"a bag of {size / 1e9:.2f} GB, {messages} messages")
            good.append(finds_its_place(listener, large, messages))
            for chunk in (10_000, 4_000_000):
                opens(Path(directory) / "chunks.mcap", chunk)
        finally:
            rclpy.try_shutdown(context=context)
    return 0 if all(good) else 1


if __name__ == "__main__":
    sys.exit(main())
