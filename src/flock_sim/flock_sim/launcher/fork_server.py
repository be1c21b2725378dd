# SPDX-License-Identifier: Apache-2.0
"""A process that forks others from itself, so that they start with all imports done.

A node process spends most of its start on importing rclpy and numba and on loading kernels. The
fork server does this once. It is a copy of the process that requests it (`ForkServer.fork`) or, if
that process has threads, a new process (`ForkServer.spawn`). It never starts a thread or
initialises ROS: a fork copies one thread only, and a lock that another thread holds stays locked in
the copy.

The server ends when the client that made it closes the connection or ends. If it listens at an
address, other processes of the same user can connect to it too (`ForkServer.connect`).
"""

from __future__ import annotations

import atexit
import fcntl
import importlib
import json
import os
import secrets
import select
import signal
import socket
import struct
import subprocess
import sys
import time
import traceback
import weakref
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from typing import Any, NoReturn

from flock_sim.console.signals import ENDING, SUPERVISED, end_process, end_with_parent
from flock_sim.launcher.forkable import CannotFork, check_forkable, check_system

TIMEOUT = 60.0
"""Longest wait for a fork server to preload and to answer, in s."""

MOST_BYTES = 1 << 20
SPARE = 512
"""File descriptors below this number are free in a child before it gets its own."""


@dataclass(frozen=True)
class Program:
    """What a forked process runs: the function `main` of a module, as `python -m` would."""

    module: str
    arguments: Sequence[str]
    name: str
    """Name such as "bird-3": `ps` shows it after the module, and ROS uses it for log files."""
    environment: Mapping[str, str] = field(default_factory=lambda: dict(os.environ))
    directory: str = field(default_factory=os.getcwd)
    supervised: bool = False
    """Whether it leaves Ctrl-C to its parent; SUPERVISED tells it so."""
    new_session: bool = False


class Child:
    """A process forked by a server; used like `subprocess.Popen`."""

    def __init__(self, server: ForkServer, pid: int) -> None:
        """Watch process `pid` of `server`."""
        self.pid = pid
        self.returncode: int | None = None
        """Exit status, or minus the number of the signal that killed it; None while it runs."""
        self._server = server
        self._handle: int | None = None
        with suppress(ProcessLookupError):  # it has ended, and the server reports its status
            self._handle = os.pidfd_open(pid)

    def poll(self) -> int | None:
        """Return `returncode`."""
        if self.returncode is None:
            self._server.update()
        if self.returncode is None and self._server.gone and self._dead():
            self.returncode = -signal.SIGKILL  # the status is lost with the server
        if self.returncode is not None and self._handle is not None:
            os.close(self._handle)
            self._handle = None
        return self.returncode

    def wait(self, timeout: float | None = None) -> int:
        """Wait for the end and return `returncode`. Raises subprocess.TimeoutExpired."""
        deadline = None if timeout is None else time.monotonic() + timeout
        while (status := self.poll()) is None:
            if deadline is not None and time.monotonic() >= deadline:
                assert timeout is not None
                raise subprocess.TimeoutExpired(f"process {self.pid}", timeout)
            self._server.pause(0.05 if deadline is None else deadline - time.monotonic())
        return status

    def send_signal(self, number: int) -> None:
        """Send a signal, unless the process has ended."""
        if self.poll() is None and self._handle is not None:
            with suppress(ProcessLookupError):
                signal.pidfd_send_signal(self._handle, number)

    def kill(self) -> None:
        """Kill the process."""
        self.send_signal(signal.SIGKILL)

    def _dead(self) -> bool:
        return self._handle is None or bool(select.select([self._handle], [], [], 0)[0])


class ForkServer:
    """The client's side of a fork server."""

    def __init__(
        self,
        connection: socket.socket,
        end: Callable[[], object],
        address: str = "",
        timeout: float = TIMEOUT,
    ) -> None:
        """Use a server over `connection`; `end` ends it. It must answer within `timeout` s."""
        self.gone = False
        """Whether the server has ended, for whatever reason."""
        self.address = address
        """Address for connections of other processes; empty: none."""
        self._connection = connection
        self._end = end
        self._timeout = timeout
        self._children: dict[int, Child] = {}
        self._answers: list[dict[str, Any]] = []

    @classmethod
    def fork(cls) -> ForkServer:
        """Return a server that is a copy of this process. Raises CannotFork."""
        check_forkable()
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        sys.stdout.flush()
        sys.stderr.flush()
        pid = os.fork()
        if pid == 0:
            try:
                _forget_ends()
                _Server(_keep_only(theirs)).serve()
            finally:
                os._exit(0)
        theirs.close()

        def end() -> None:
            os.kill(pid, signal.SIGKILL)
            os.waitpid(pid, 0)

        return cls(ours, end)

    @classmethod
    def spawn(cls, preload: str, *, listen: bool = False, timeout: float = TIMEOUT) -> ForkServer:
        """Return a server that is a new process; `preload` is "module:function", called first.

        The first request waits for this call: `timeout`, in s, must allow for that.

        Raises CannotFork; if the new process can't fork, only the first `start` raises it.
        """
        check_system()
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        address = f"flock-fork-server-{secrets.token_hex(8)}" if listen else ""
        with theirs, socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as listener:
            if listen:
                listener.bind(f"\0{address}")
                listener.listen()
            sockets = [theirs.fileno(), *([listener.fileno()] if listen else [])]
            process = subprocess.Popen(
                [sys.executable, "-P", "-m", __name__, preload, *map(str, sockets)],
                stdin=subprocess.DEVNULL,
                env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
                pass_fds=sockets,
            )

        def end() -> None:
            process.kill()
            process.wait()

        return cls(ours, end, address, timeout)

    @classmethod
    def connect(cls, address: str) -> ForkServer:
        """Return the server that listens at `address`. Raises CannotFork.

        It kills those of its children that are still alive when this process ends.
        """
        connection = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        try:
            connection.connect(f"\0{address}")
        except OSError as error:
            connection.close()
            raise CannotFork(f"no fork server listens at {address}: {error}") from error
        return cls(connection, lambda: None, address)

    def start(self, program: Program, descriptors: Mapping[int, int]) -> Child:
        """Start `program` with `descriptors`, its number to ours, as its only open files.

        Raises CannotFork if the server is gone. A server that does not answer in time is ended: a
        late answer would be taken for the answer to another request.
        """
        request = json.dumps({**asdict(program), "numbers": list(descriptors)}).encode()
        try:
            socket.send_fds(self._connection, [request], list(descriptors.values()))
        except OSError as error:
            raise CannotFork(f"the fork server does not take a request: {error}") from error
        answer = self._answer()
        if "error" in answer:
            raise CannotFork(answer["error"])
        return self._children[answer["pid"]]

    def update(self) -> None:
        """Take the messages that the server has sent."""
        while not self.gone and select.select([self._connection], [], [], 0)[0]:
            self._take()

    def pause(self, longest: float) -> None:
        """Wait until the server sends a message, for 0.05 s or `longest` at most."""
        longest = max(0.0, min(longest, 0.05))
        if self.gone:
            time.sleep(longest)
        else:
            select.select([self._connection], [], [], longest)

    def close(self) -> None:
        """End the server, once; its children get a SIGTERM."""
        self.gone = True
        self._connection.close()
        end, self._end = self._end, lambda: None
        end()

    def _take(self) -> None:
        try:
            data = self._connection.recv(MOST_BYTES)
        except OSError:
            data = b""
        if not data:
            self.gone = True
            return
        told = json.loads(data)
        if "ended" in told:
            child = self._children.pop(told["ended"], None)
            if child is not None:
                child.returncode = told["status"]
            return
        if "pid" in told:
            self._children[told["pid"]] = Child(self, told["pid"])
        self._answers.append(told)

    def _answer(self) -> dict[str, Any]:
        """Return the answer to the last request. Raises CannotFork if none comes."""
        deadline = time.monotonic() + self._timeout
        while not self._answers and not self.gone:
            left = deadline - time.monotonic()
            if left <= 0.0:
                self.close()
                raise CannotFork(f"the fork server does not answer within {self._timeout:g} s")
            if select.select([self._connection], [], [], left)[0]:
                self._take()
        if not self._answers:
            raise CannotFork("the fork server has ended")
        return self._answers.pop()


def _forget_ends() -> None:
    """Remove the original's exit handlers from this copy, such as those for temporary files."""
    atexit._clear()
    weakref.finalize._registry.clear()  # type: ignore[attr-defined]
    weakref.finalize._registered_with_atexit = False  # type: ignore[attr-defined]


def _keep_only(connection: socket.socket) -> socket.socket:
    """Close all files but the standard ones and `connection`; return that, at a low number.

    Otherwise the copy would keep locks and the claim of a domain open.
    """
    high = fcntl.fcntl(connection.fileno(), fcntl.F_DUPFD_CLOEXEC, SPARE)
    os.closerange(3, SPARE)
    os.dup2(high, 3, inheritable=False)
    os.closerange(SPARE, high + 1)
    return socket.socket(fileno=3)


class _Server:
    """The server's side: it forks programs on request and reports their exit statuses."""

    def __init__(self, owner: socket.socket, listener: socket.socket | None = None) -> None:
        """Serve `owner`, and the clients that connect to `listener`, until `owner` is gone."""
        self._owner = owner
        self._listener = listener
        self._connections = {owner.fileno(): owner}
        self._children: dict[int, tuple[int, socket.socket]] = {}  # by handle
        self._poll = select.poll()
        for one in filter(None, (owner, listener)):
            self._poll.register(one, select.POLLIN)

    def serve(self) -> None:
        """Serve until the owner is gone."""
        for number in ENDING:
            signal.signal(number, signal.SIG_IGN)  # the owner ends this process
        _show(__name__)
        while self._owner.fileno() >= 0:
            for descriptor, _ in self._poll.poll():
                if descriptor in self._children:
                    self._bury(descriptor)
                elif descriptor in self._connections:
                    self._answer(self._connections[descriptor])
                elif self._listener is not None:
                    self._admit(self._listener)

    def _bury(self, handle: int) -> None:
        """Report the exit status of a child that has ended."""
        self._poll.unregister(handle)
        os.close(handle)
        pid, connection = self._children.pop(handle)
        _, status = os.waitpid(pid, 0)
        _tell(connection, {"ended": pid, "status": os.waitstatus_to_exitcode(status)})

    def _admit(self, listener: socket.socket) -> None:
        """Accept a connection if its process has the same user as this server."""
        connection, _ = listener.accept()
        told = connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, 12)
        _, user, _ = struct.unpack("3i", told)
        if user != os.getuid():
            connection.close()
            return
        self._connections[connection.fileno()] = connection
        self._poll.register(connection, select.POLLIN)

    def _answer(self, connection: socket.socket) -> None:
        """Fork the requested program."""
        try:
            data, received, _, _ = socket.recv_fds(connection, MOST_BYTES, 253)
        except OSError:
            data, received = b"", []
        if not data:
            self._dismiss(connection)
            return
        server = os.getpid()
        try:
            pid = os.fork()
        except OSError as error:
            pid = -1
            _tell(connection, {"error": f"no process can be forked: {error.strerror}"})
        if pid == 0:
            _run(json.loads(data), received, server)
        for file in received:
            os.close(file)
        if pid < 0:
            return
        handle = os.pidfd_open(pid)
        self._children[handle] = pid, connection
        self._poll.register(handle, select.POLLIN)
        _tell(connection, {"pid": pid})

    def _dismiss(self, connection: socket.socket) -> None:
        """Drop a client that is gone, and kill its children."""
        for handle, (_, client) in self._children.items():
            if client is connection and client is not self._owner:
                signal.pidfd_send_signal(handle, signal.SIGKILL)
        self._poll.unregister(connection)
        del self._connections[connection.fileno()]
        connection.close()


def _tell(connection: socket.socket, what: dict[str, object]) -> None:
    with suppress(OSError):  # the client is gone: the next poll of the connection detects it
        connection.send(json.dumps(what).encode())


def _run(request: dict[str, Any], received: list[int], server: int) -> NoReturn:
    """Run the requested program in this new child of process `server`."""
    status = 1
    try:
        numbers = request.pop("numbers")
        program = Program(**request)
        _take_files(numbers, received)
        _take_signals(program.supervised)
        end_with_parent()
        if os.getppid() != server:
            os.kill(os.getpid(), signal.SIGTERM)  # it ended before it could be heard
        if program.new_session:
            os.setsid()
        os.environ.clear()
        os.environ.update(program.environment)
        if program.supervised:
            os.environ[SUPERVISED] = str(os.getppid())
        os.chdir(program.directory)
        sys.argv = [program.module, *program.arguments]
        _show(f"{program.module}:{program.name}")
        status = _status(importlib.import_module(program.module).main)
        end_process(status)
    except BaseException:
        traceback.print_exc()
    finally:
        os._exit(status)


def _status(main: Callable[[], object]) -> int:
    """Return the exit status of a program that consists of a call of `main`."""
    try:
        result = main()
    except SystemExit as error:
        result = error.code
    if result is None or isinstance(result, int):
        return (result or 0) & 0xFF
    print(result, file=sys.stderr)
    return 1


def _take_files(numbers: Sequence[int], received: Sequence[int]) -> None:
    """Keep only the files `received`, with `numbers`, and renew the standard streams."""
    high = [fcntl.fcntl(file, fcntl.F_DUPFD_CLOEXEC, SPARE) for file in received]
    os.closerange(3, SPARE)
    for number, file in zip(numbers, high, strict=True):
        os.dup2(file, number)
        os.close(file)
    _renew_streams(sys.stdout.encoding)


def _renew_streams(encoding: str) -> None:
    """Open the standard streams of Python anew, as for a new process."""
    sys.stdin = open(0, encoding=encoding, closefd=False)  # noqa: SIM115
    sys.stdout = open(1, "w", encoding=encoding, closefd=False)  # noqa: SIM115
    sys.stderr = open(2, "w", 1, encoding, "backslashreplace", closefd=False)  # noqa: SIM115
    sys.__stdin__, sys.__stdout__, sys.__stderr__ = sys.stdin, sys.stdout, sys.stderr  # type: ignore[misc]


def _take_signals(supervised: bool) -> None:
    """Set the signal handlers of a new program; if supervised, it leaves Ctrl-C to its parent."""
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_DFL)
    signal.signal(signal.SIGINT, signal.SIG_IGN if supervised else signal.default_int_handler)
    signal.pthread_sigmask(signal.SIG_SETMASK, [])


def _show(title: str) -> None:
    """Set the title that `ps` shows, if the library for it is installed."""
    try:
        from setproctitle import setproctitle
    except ImportError:
        return
    setproctitle(title)


def main() -> None:
    """Run a server that `spawn` has started."""
    preload, *numbers = sys.argv[1:]
    owner, *listener = (socket.socket(fileno=int(number)) for number in numbers)
    for one in (owner, *listener):
        one.set_inheritable(False)
    module, _, function = preload.partition(":")
    getattr(importlib.import_module(module), function)()
    try:
        check_forkable()
    except CannotFork as error:
        while owner.recv(MOST_BYTES):
            _tell(owner, {"error": str(error)})
    else:
        _Server(owner, *listener).serve()
    os._exit(0)


if __name__ == "__main__":
    main()
