# SPDX-License-Identifier: Apache-2.0
"""A simulated terminal of a user: it starts tools, and checks that they leave nothing behind.

Tools are forked from a server that has imported all of them (forked.py). They have a session of
their own, by which their child processes are found in /proc. New processes are also found by a mark
in their environment. All files of tools are below one directory.
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
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from flock_sim.launcher.fork_server import Child, ForkServer
from flock_sim.launcher.forked_program import Program
from flock_sim.ros.discovery import FIRST_PORT, LAST_DOMAIN, PORTS, quiet_domains
from flock_sim.ros.settings_check import shared_memory, udp_sockets
from support.forked import TOOLS, fork_server

DEADLINE = 300.0
"""Time after which a tool counts as hung, in s: ten times the slowest on two idle cores."""

POLL = 0.02

FIRST_PAUSE, LONGEST_PAUSE = 0.2, 2.0
"""Time between looks at the processes of a terminal: at first, and at most, in s."""

MARK = "FLOCK_TEST_MARK"

STREAMS = ("stdin", "stdout", "stderr")


@dataclass(frozen=True)
class Done:
    """The exit status and the output of a tool."""

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
        """The last line, an `error: ` line. Stderr has no other such line, and no traceback.

        Notes, such as the path of a recorded flight, may precede it.
        """
        assert "Traceback" not in self.stderr, self.stderr
        *notes, last = self.stderr.splitlines() or [""]
        assert last.startswith("error: "), self.stderr
        assert not [line for line in notes if line.startswith("error: ")], self.stderr
        return last


class Job:
    """A tool that was started."""

    def __init__(
        self, terminal: Terminal, process: subprocess.Popen[bytes] | Child, log: Path
    ) -> None:
        self.process = process
        self.begun = time.monotonic()
        self._terminal = terminal
        self._log = log

    @property
    def stderr(self) -> str:
        """The output on stderr so far."""
        return self._log.with_suffix(".err").read_text(encoding="utf-8")

    @property
    def stdout(self) -> str:
        """The output on stdout so far."""
        return self._log.with_suffix(".out").read_text(encoding="utf-8")

    @property
    def running(self) -> bool:
        """Whether it has not ended yet."""
        return self.process.poll() is None

    def until(self, condition: Callable[[], Any], within: float = DEADLINE) -> Any:
        """Wait until `condition` is true, and return its value. The tool must not end before."""
        deadline = time.monotonic() + within
        while not (value := condition()):
            assert self.running, f"ended with {self.process.returncode}: {self.stderr}"
            assert time.monotonic() < deadline, f"not within {within:g} s: {self.stderr}"
            self._terminal.look_sometimes()
            time.sleep(POLL)
        return value

    def until_connected(self) -> Job:
        """Wait until the tool is on the DDS network."""
        self.until(lambda: ports(self.process.pid))
        return self

    def until_said(self, words: str, within: float = DEADLINE) -> Job:
        """Wait until the tool has written `words` to stderr."""
        self.until(lambda: words in self.stderr, within)
        return self

    def workers(self, module: str) -> list[int]:
        """Return the processes that run `module` on behalf of this tool."""
        assert find_spec(module), module
        return [
            pid
            for pid in self._terminal.processes()
            if any(word == module or word.startswith(f"{module}:") for word in _words(pid))
        ]

    def interrupt(self) -> None:
        """Press Ctrl-C: the terminal sends SIGINT to every process of the group."""
        self._terminal.look()
        self._signal_all(signal.SIGINT)

    def kill(self) -> Done:
        """Kill all processes of the tool at once. The status is its own if it had ended before."""
        self._signal_all(signal.SIGKILL)
        return self.wait()

    def _signal_all(self, number: signal.Signals) -> None:
        with suppress(ProcessLookupError):  # the tool may end at any moment
            os.killpg(self.process.pid, number)

    def send(self, number: signal.Signals) -> None:
        """Send a signal to the tool alone."""
        self._terminal.look()
        self.process.send_signal(number)

    def wait(self, within: float = DEADLINE) -> Done:
        """Wait for the end of the tool."""
        deadline = time.monotonic() + within
        while self.running:
            assert time.monotonic() < deadline, f"still runs after {within:g} s: {self.stderr}"
            self._terminal.look_sometimes()
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
        self._sessions: set[int] = set()
        self._shared: set[str] = set()
        self._next_look, self._pause = 0.0, FIRST_PAUSE
        self._count = 0

    def start(
        self,
        tool: str,
        *arguments: object,
        enter: Sequence[str] = (),
        server: ForkServer | None = None,
        **options: Any,
    ) -> Job:
        """Start a tool as a user does. `options` are passed to Popen.

        `server` forks it; None is the server of all tests.
        `enter` is a prefix of the command, such as `nsenter ...`. With a prefix, or with options
        other than streams and `env`, the tool is a new process of Python; otherwise it is a fork.
        """
        if enter or not set(options) <= {*STREAMS, "env"}:
            module = [*enter, sys.executable, "-P", "-m", TOOLS[tool]]
            return self.start_command(tool, [*module, *map(str, arguments)], **options)
        program = Program(
            TOOLS[tool],
            list(map(str, arguments)),
            "test",
            options.pop("env", self.environment),
            str(self.directory),
            new_session=True,
        )
        with self._streams(tool) as (log, streams):
            streams |= options
            files = {number: _number(streams[name]) for number, name in enumerate(STREAMS)}
            process = (server or fork_server()).start(program, files)
        self._sessions.add(process.pid)
        return Job(self, process, log)

    def start_command(self, name: str, command: list[str], **options: Any) -> Job:
        """Start a command that is no tool of Flock. `name` is the name of its log."""
        with self._streams(name) as (log, streams):
            process = subprocess.Popen(
                command,
                **{
                    **streams,
                    "cwd": self.directory,
                    "env": self.environment,
                    "start_new_session": True,
                    # SIGINT is ignored if a shell has started the tests in the background.
                    "preexec_fn": lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
                    **options,
                },
            )
        return Job(self, process, log)

    @contextmanager
    def _streams(self, name: str) -> Iterator[tuple[Path, dict[str, Any]]]:
        """Give the path of a new log, without its suffix, and its streams."""
        self._count += 1
        self._next_look, self._pause = 0.0, FIRST_PAUSE
        log = self._logs / f"{self._count}-{name}"
        with (
            open(os.devnull, "rb") as nothing,
            log.with_suffix(".out").open("wb") as out,
            log.with_suffix(".err").open("wb") as err,
        ):
            yield log, dict(zip(STREAMS, (nothing, out, err), strict=True))

    def run(self, tool: str, *arguments: object) -> Done:
        """Run a tool to its end."""
        return self.start(tool, *arguments).wait()

    def well(self, tool: str, *arguments: object) -> Done:
        """Run a tool that must end without an error."""
        done = self.run(tool, *arguments)
        assert done.status == 0, done.stderr
        assert "ended by force" not in done.stderr
        return done

    def processes(self) -> list[int]:
        """Return the live processes among those started here and their children.

        A session of which no process is left is forgotten: the kernel may give its number to a
        process of another test. The first process of a session may not have begun it yet.
        """
        mark = f"{MARK}={self._mark}".encode()
        found, known, remaining = [], set(self._sessions), set()
        for entry in Path("/proc").glob("[0-9]*"):
            with suppress(OSError):
                session = os.getsid(int(entry.name))
                remaining |= {session, int(entry.name)}
                ours = session in self._sessions or mark in (entry / "environ").read_bytes()
                if ours and lives(int(entry.name)):
                    found.append(int(entry.name))
        self._sessions -= known - remaining
        return found

    def look(self) -> None:
        """Register the shared memory of the processes: Flock uses none."""
        for pid in self.processes():
            self._shared |= shared_memory(pid)

    def look_sometimes(self) -> None:
        """Look, if it is time to. A look takes 30 ms, and a process keeps what it has mapped.

        So looks become rarer until another tool is started.
        """
        if time.monotonic() >= self._next_look:
            self.look()
            self._next_look = time.monotonic() + self._pause
            self._pause = min(2.0 * self._pause, LONGEST_PAUSE)

    def left_behind(self) -> list[str]:
        """Return the leftovers of tools: processes, shared memory, temporary files."""
        files = [*self.home.iterdir(), *self.temporary.iterdir()]
        processes = [f"process {pid}: {' '.join(_words(pid))}" for pid in self.processes()]
        return [*processes, *map(str, files), *self._shared]

    def clear(self) -> None:
        """Kill all processes that still run."""
        for pid in self.processes():
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)


@contextmanager
def open_terminal(directory: Path) -> Iterator[Terminal]:
    """Give a terminal. At the end, all processes and files of its tools must be gone."""
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

    It is claimed by a name in the abstract socket namespace, which the kernel always releases.
    Flock takes the first free domain, and does not know these claims: so tests take the last one.
    """
    for domain in reversed(quiet_domains()):
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
    return {port for _, port in udp_sockets(pid) if port in all_domains}


def lives(pid: int) -> bool:
    """Whether a process runs.

    A zombie, whose status no process has read, does not run. Neither does a process that the kernel
    is ending: it has given back its memory, and with it its command line.
    """
    try:
        return _status(pid)[0] not in "ZX" and Path(f"/proc/{pid}/cmdline").read_bytes() != b""
    except OSError:
        return False


def parent(pid: int) -> int:
    """Return the parent of a process: the one that started or inherited it."""
    return int(_status(pid)[1])


def _status(pid: int) -> list[str]:
    """Return the kernel's status fields of a process, from its state on. Raises OSError."""
    told = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8")
    return told.rpartition(")")[2].split()


def _words(pid: int) -> list[str]:
    """Return the words of a command line, or of the process title that replaced it."""
    with suppress(OSError):
        return Path(f"/proc/{pid}/cmdline").read_bytes().decode().replace("\0", " ").split()
    return []


def _number(stream: Any) -> int:
    return stream if isinstance(stream, int) else stream.fileno()
