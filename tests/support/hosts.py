# SPDX-License-Identifier: Apache-2.0
"""Several simulated hosts on this machine, and a network between them with losses and delays.

A host has its own network with a loopback, and shares files and processes with all others. It is an
unnamed network namespace: the kernel removes it with its last process, and the process that holds
it open ends with the test.
"""

from __future__ import annotations

import fcntl
import heapq
import os
import select
import shutil
import struct
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from random import Random

TUN = Path("/dev/net/tun")
TUNSETIFF = 0x400454CA
IFF_TAP, IFF_NO_PI = 0x0002, 0x1000

NETWORK = "10.77.0"
MAC = "02:00:00:00:00"
IP_MULTICAST = b"\x01\x00\x5e"
IPV4, UDP = b"\x08\x00", 17

FRAME = 2048
"""Read size in bytes, larger than any frame: the devices' MTU is 1500."""


def unavailable() -> str:
    """Return the reason why hosts are not possible here; empty if they are."""
    if os.geteuid() != 0:
        return "hosts need root"
    absent = [tool for tool in ("ip", "unshare", "nsenter") if not shutil.which(tool)]
    if absent:
        return f"hosts need {' and '.join(absent)} (Debian: iproute2, util-linux)"
    if not TUN.exists():
        return f"hosts need {TUN}"
    tried = subprocess.run(["unshare", "--net", "true"], capture_output=True, text=True)
    return tried.stderr.strip()


@dataclass(frozen=True)
class Weather:
    """The faults of datagrams between hosts."""

    loss: float = 0.0  # probability of a loss
    delay: tuple[float, float] = (0.0, 0.0)  # in s; uniformly random in this range
    multicast: bool = True  # whether the network carries it
    seed: int = 1


@dataclass
class Traffic:
    """Counts of datagrams so far, each counted once for each receiver."""

    sent: int = 0
    lost: int = 0
    arrived: int = 0
    overtaken: int = 0  # arrived after a later one of the same way
    shortest: float = float("inf")  # shortest time on the way, in s
    _latest: dict[tuple[int, int], int] = field(default_factory=dict)

    def arrive(self, letter: Letter, now: float) -> None:
        """Register the delivery of `letter` at time `now`."""
        self.arrived += 1
        self.shortest = min(self.shortest, now - letter.sent)
        way = (letter.source, letter.target)
        if letter.number < self._latest.get(way, -1):
            self.overtaken += 1
        self._latest[way] = max(letter.number, self._latest.get(way, -1))


@dataclass(frozen=True, order=True)
class Letter:
    """A frame in flight. Letters are ordered by due time."""

    due: float
    number: int
    sent: float = field(compare=False)
    source: int = field(compare=False)
    target: int = field(compare=False)
    frame: bytes = field(compare=False)


class Host:
    """A simulated host with its own network."""

    def __init__(self, number: int, holder: subprocess.Popen[bytes]) -> None:
        self.address = f"{NETWORK}.{number}"
        self._number = number
        self._holder = holder

    def enter(self, directory: Path) -> list[str]:
        """Return the prefix of a command that runs it on this host, in `directory`."""
        spaces = ["nsenter", f"--target={self._holder.pid}", "--net"]
        return [*spaces, "env", f"--chdir={directory}"]

    def plug_in(self, device: str) -> None:
        """Move the network device from this machine to the host and start its network."""
        subprocess.run(["ip", "link", "set", device, "netns", str(self._holder.pid)], check=True)
        commands = (
            "link set lo up",
            f"link set {device} address {MAC}:{self._number:02x} up",
            f"address add {self.address}/24 dev {device}",
            f"route add 224.0.0.0/4 dev {device}",
        )
        ip = [*self.enter(Path("/")), "ip", "-batch", "-"]
        subprocess.run(ip, input="\n".join(commands), text=True, check=True)


class Relay(threading.Thread):
    """The network between the hosts. It carries Ethernet frames between TAP devices."""

    def __init__(self, taps: list[int], weather: Weather) -> None:
        super().__init__(name="relay", daemon=True)
        self.traffic = Traffic()
        self._taps = taps
        self._weather = weather
        self._random = Random(weather.seed)
        self._under_way: list[Letter] = []
        self._ended, self._end = os.pipe()

    def run(self) -> None:
        """Carry frames until `stop`."""
        poll = select.poll()
        for descriptor in (*self._taps, self._ended):
            poll.register(descriptor, select.POLLIN)
        while True:
            ready = {descriptor for descriptor, _ in poll.poll(self._until_next_due())}
            if self._ended in ready:
                return
            for source, tap in enumerate(self._taps):
                if tap in ready:
                    self._accept(source, os.read(tap, FRAME))
            self._hand_over()

    def stop(self) -> None:
        """End. Frames in flight are lost."""
        os.write(self._end, b"x")
        self.join()
        for descriptor in (self._ended, self._end):
            os.close(descriptor)

    def _until_next_due(self) -> float | None:
        """Return the time until the next due frame, in ms; None without a frame."""
        if not self._under_way:
            return None
        return max(0.0, 1e3 * (self._under_way[0].due - time.monotonic()))

    def _accept(self, source: int, frame: bytes) -> None:
        now = time.monotonic()
        for target in self._targets(source, frame):
            if not _is_datagram(frame):  # such as ARP: DDS can't repair its loss
                os.write(self._taps[target], frame)
                continue
            self.traffic.sent += 1
            if self._random.random() < self._weather.loss:
                self.traffic.lost += 1
                continue
            due = now + self._random.uniform(*self._weather.delay)
            letter = Letter(due, self.traffic.sent, now, source, target, frame)
            heapq.heappush(self._under_way, letter)

    def _targets(self, source: int, frame: bytes) -> list[int]:
        """Return the receivers of a frame: the host of its address, or all others."""
        if frame[:3] == IP_MULTICAST and not self._weather.multicast:
            return []
        others = [target for target in range(len(self._taps)) if target != source]
        if frame[0] & 1:
            return others
        return [target for target in others if frame[5] == target + 1]

    def _hand_over(self) -> None:
        while self._under_way and self._under_way[0].due <= time.monotonic():
            letter = heapq.heappop(self._under_way)
            self.traffic.arrive(letter, time.monotonic())
            os.write(self._taps[letter.target], letter.frame)


def _is_datagram(frame: bytes) -> bool:
    """Return whether an Ethernet frame carries UDP, or a later fragment of it."""
    return frame[12:14] == IPV4 and frame[23] == UDP


@contextmanager
def joined_hosts(count: int, weather: Weather) -> Iterator[tuple[list[Host], Traffic]]:
    """Give `count` hosts on one network, and the counts of its datagrams."""
    with ExitStack() as stack:
        hosts = [stack.enter_context(_host(number)) for number in range(1, count + 1)]
        taps = [stack.enter_context(_tap(host)) for host in hosts]
        relay = Relay(taps, weather)
        relay.start()
        stack.callback(relay.stop)
        yield hosts, relay.traffic


@contextmanager
def _host(number: int) -> Iterator[Host]:
    """Give a host. It exists as long as a child process, which ends with its input."""
    command = ["unshare", "--net", "sh", "-c", "echo up && exec cat"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == b"up\n"
        yield Host(number, holder)


@contextmanager
def _tap(host: Host) -> Iterator[int]:
    """Give the descriptor of a TAP device of `host`. The device is removed once it is closed."""
    tap = os.open(TUN, os.O_RDWR)
    try:
        request = struct.pack("16sH22x", b"flock%d", IFF_TAP | IFF_NO_PI)
        device = fcntl.ioctl(tap, TUNSETIFF, request)[:16].rstrip(b"\0").decode()
        host.plug_in(device)
        yield tap
    finally:
        os.close(tap)
