# SPDX-License-Identifier: Apache-2.0
"""A user's terminal in the hands of a test: starts tools, and sees that nothing is left of them.

Everything that a tool starts inherits a mark in its environment, by which it is found in /proc,
whoever its parent is by now. All that tools could write by themselves goes below one directory.
"""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import time
import uuid
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from flock_sim.discovery import FIRST_PORT, LAST_DOMAIN, PORTS, quiet_domains

TOOLS = {
    "fly": "flock_sim.fly",
    "reference": "flock_sim.reference",
    "bird": "flock_sim.nodes.bird",
    "clock": "flock_sim.nodes.clock",
    "recorder": "flock_sim.nodes.recorder",
    "metrics": "flock_tools.metrics",
    "compare": "flock_tools.compare",
    "picture": "flock_tools.picture",
    "report": "flock_tools.report",
    "figures": "flock_tools.figures",
    "play": "flock_tools.play",
    "watch": "flock_tools.watch",
    "view": "flock_tools.view",
    "repair": "flock_tools.repair",
    "equilibrium": "flock_tools.equilibrium",
    "limits": "flock_tools.limits",
    "survey": "flock_tools.survey",
    "study": "flock_tools.study",
    "sweep": "flock_tools.sweep",
}

DEADLINE = 300.0
"""Time, in s, after which a tool hangs: some ten times what the slowest takes on two idle cores."""

POLL = 0.02

MARK = "FLOCK_TEST_MARK"


@dataclass(frozen=True)
class Done:
    """What a user sees of a tool that has ended."""

    status: int
    stdout: str
    stderr: str

    @property
    def json(self) -> dict[str, Any]:
        """The one JSON object on stdout."""
        value = json.loads(self.stdout)
        assert isinstance(value, dict)
        return value

    @property
    def error(self) -> str:
        """The one line that begins with `error: `; stderr holds no other such line, no traceback.

        Notes, such as where a flight is recorded, may stand before it.
        """
        assert "Traceback" not in self.stderr, self.stderr
        *notes, last = self.stderr.splitlines() or [""]
        assert last.startswith("error: "), self.stderr
        assert not [line for line in notes if line.startswith("error: ")], self.stderr
        return last


class Job:
    """A tool that was started."""

    def __init__(self, terminal: Terminal, process: subprocess.Popen[bytes], log: Path) -> None:
        self.process = process
        self.begun = time.monotonic()
        self._terminal = terminal
        self._log = log

    @property
    def stderr(self) -> str:
        """What it has said on stderr so far."""
        return self._log.with_suffix(".err").read_text(encoding="utf-8")

    @property
    def stdout(self) -> str:
        """What it has printed so far."""
        return self._log.with_suffix(".out").read_text(encoding="utf-8")

    @property
    def running(self) -> bool:
        """Whether it has not ended yet."""
        return self.process.poll() is None

    def until(self, condition: Callable[[], Any], within: float = DEADLINE) -> Any:
        """Wait until `condition` is true, and return what it gave; the tool must not end before."""
        deadline = time.monotonic() + within
        while not (value := condition()):
            assert self.running, f"ended with {self.process.returncode}: {self.stderr}"
            assert time.monotonic() < deadline, f"not within {within:g} s: {self.stderr}"
            self._terminal.look()
            time.sleep(POLL)
        return value

    def until_connected(self) -> Job:
        """Wait until the tool is on the DDS network."""
        self.until(lambda: ports(self.process.pid))
        return self

    def until_said(self, words: str, within: float = DEADLINE) -> Job:
        """Wait until the tool has said `words` on stderr."""
        self.until(lambda: words in self.stderr, within)
        return self

    def workers(self, module: str) -> list[int]:
        """Return the processes that run `module` on behalf of this tool."""
        return [
            pid for pid in self._terminal.processes() if module in _words(pid)
        ]  # fmt: skip

    def interrupt(self) -> None:
        """Press Ctrl-C: the terminal sends SIGINT to every process of the group."""
        self._terminal.look()
        os.killpg(self.process.pid, signal.SIGINT)

    def send(self, number: signal.Signals) -> None:
        """Send a signal to the tool alone."""
        self._terminal.look()
        self.process.send_signal(number)

    def wait(self, within: float = DEADLINE) -> Done:
        """Wait for the end."""
        deadline = time.monotonic() + within
        while self.running:
            assert time.monotonic() < deadline, f"still runs after {within:g} s: {self.stderr}"
            self._terminal.look()
            time.sleep(POLL)
        return Done(self.process.returncode, self.stdout, self.stderr)


class Terminal:
    """Starts tools in a directory of their own, on a DDS domain of their own."""

    def __init__(self, directory: Path, domain: int) -> None:
        self.home, self.temporary = directory / "home", directory / "tmp"
        self.directory = directory / "work"
        self._logs = directory / "log"
        for made in (self.home, self.temporary, self.directory, self._logs):
            made.mkdir(parents=True)
        self._mark = uuid.uuid4().hex
        self.environment = {
            **os.environ,
            "HOME": str(self.home),
            "TMPDIR": str(self.temporary),
            "ROS_LOG_DIR": str(self._logs),
            "MPLCONFIGDIR": str(self._logs),
            "ROS_DOMAIN_ID": str(domain),
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
            MARK: self._mark,
        }
        self.environment.pop("FLOCK_SUPERVISED", None)
        self._shared: set[str] = set()
        self._looked = 0.0
        self._count = 0

    def start(
        self, tool: str, *arguments: object, enter: Sequence[str] = (), **options: Any
    ) -> Job:
        """Start a tool, as a user does; `options` go to Popen.

        `enter` are words before the command, such as `nsenter ...`.
        """
        module = [*enter, sys.executable, "-P", "-m", TOOLS[tool]]
        return self.start_command(tool, [*module, *map(str, arguments)], **options)

    def start_command(self, name: str, command: list[str], **options: Any) -> Job:
        """Start what is none of our tools; `name` is that of its log."""
        self._count += 1
        log = self._logs / f"{self._count}-{name}"
        with log.with_suffix(".out").open("wb") as out, log.with_suffix(".err").open("wb") as err:
            process = subprocess.Popen(
                command,
                **{
                    "stdin": subprocess.DEVNULL,
                    "stdout": out,
                    "stderr": err,
                    "cwd": self.directory,
                    "env": self.environment,
                    "start_new_session": True,
                    **options,
                },
            )
        return Job(self, process, log)

    def run(self, tool: str, *arguments: object) -> Done:
        """Run a tool to its end."""
        return self.start(tool, *arguments).wait()

    def well(self, tool: str, *arguments: object) -> Done:
        """Run a tool that must end well."""
        done = self.run(tool, *arguments)
        assert done.status == 0, done.stderr
        assert "ended by force" not in done.stderr
        return done

    def processes(self) -> list[int]:
        """Return the processes that live of those started here, and of those that they started."""
        mark = f"{MARK}={self._mark}".encode()
        found = []
        for entry in Path("/proc").glob("[0-9]*"):
            with suppress(OSError):
                if mark in (entry / "environ").read_bytes().split(b"\0"):
                    found.append(int(entry.name))
        return found

    def look(self) -> None:
        """Take note of the shared memory that our processes use, now and then: Flock uses none."""
        if time.monotonic() - self._looked < 0.2:
            return
        for pid in self.processes():
            self._shared |= shared_memory(pid)
        self._looked = time.monotonic()

    def left_behind(self) -> list[str]:
        """Return what is left of our tools: processes, shared memory, temporary files."""
        files = [*self.home.iterdir(), *self.temporary.iterdir()]
        processes = [f"process {pid}: {' '.join(_words(pid))}" for pid in self.processes()]
        return [*processes, *map(str, files), *self._shared]

    def clear(self) -> None:
        """End what still runs and remove what is left."""
        for pid in self.processes():
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)


@contextmanager
def open_terminal(directory: Path) -> Iterator[Terminal]:
    """Give a terminal; at the end nothing may be left of what was started in it."""
    with own_domain() as domain:
        terminal = Terminal(directory, domain)
        try:
            yield terminal
            left = terminal.left_behind()
            assert not left, "left behind: " + ", ".join(left)
        finally:
            terminal.clear()


@contextmanager
def own_domain() -> Iterator[int]:
    """Give a ROS_DOMAIN_ID that no other test has, in this run of pytest or another.

    Claimed by a name in the abstract socket namespace: the kernel gives it back whatever happens.
    """
    for domain in quiet_domains():
        claim = socket.socket(socket.AF_UNIX)
        try:
            claim.bind(f"\0flock-test-domain-{domain}")
        except OSError:
            claim.close()
            continue
        with claim:
            yield domain
        return
    raise AssertionError("every ROS_DOMAIN_ID from 1 to 100 is in use")


def ports(pid: int) -> set[int]:
    """Return the ports of ROS domains on which a process listens."""
    all_domains = range(FIRST_PORT, FIRST_PORT + PORTS * (LAST_DOMAIN + 1))
    return {port for _, port in sockets(pid) if port in all_domains}


def sockets(pid: int) -> set[tuple[str, int]]:
    """Return address and port of each UDP socket that a process has."""
    links, table = set(), ""
    with suppress(OSError):  # it may have ended
        for link in Path(f"/proc/{pid}/fd").iterdir():
            with suppress(OSError):  # or have closed this one
                links.add(os.readlink(link))
        table = Path(f"/proc/{pid}/net/udp").read_text(encoding="ascii")
    found = set()
    for line in table.splitlines()[1:]:
        _, local, _, _, _, _, _, _, _, inode, *_ = line.split()
        if f"socket:[{inode}]" in links:
            address, _, port = local.partition(":")
            native = int(address, 16).to_bytes(4, sys.byteorder)
            found.add((socket.inet_ntoa(native), int(port, 16)))
    return found


def shared_memory(pid: int) -> set[str]:
    """Return the shared memory of Fast DDS that a process has mapped."""
    try:
        maps = Path(f"/proc/{pid}/maps").read_text(encoding="utf-8")
    except OSError:
        return set()
    return {word for word in maps.split() if word.startswith("/dev/shm/fastrtps_")}


def _words(pid: int) -> list[str]:
    with suppress(OSError):
        return Path(f"/proc/{pid}/cmdline").read_bytes().decode().split("\0")
    return []
