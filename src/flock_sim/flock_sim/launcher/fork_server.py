# SPDX-License-Identifier: Apache-2.0
"""The client's side of a fork server, which forks processes that have all imports done.

A node process spends most of its start on importing rclpy and numba and on loading kernels. The
fork server does this once. It is a copy of the process that requests it (`ForkServer.fork`) or, if
that process has threads, a new process (`ForkServer.spawn`). It never starts a thread or
initialises ROS: a fork copies one thread only, and a lock that another thread holds stays locked in
the copy.

The server ends when the client that made it closes the connection or ends. If it listens at an
address, other processes of the same user can connect to it too (`ForkServer.connect`).
"""

from __future__ import annotations

import json
import os
import secrets
import select
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import asdict
from typing import Any

from flock_sim.launcher import fork_server_process
from flock_sim.launcher.fork_server_process import MOST_BYTES
from flock_sim.launcher.forkable import CannotFork, check_forkable, check_system
from flock_sim.launcher.forked_program import Program

TIMEOUT = 60.0
"""Longest wait for a fork server to preload and to answer, in s."""


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
    """A fork server, as its client uses it. The server itself is `fork_server_process`."""

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
                fork_server_process.serve_after_fork(theirs)
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
                [
                    sys.executable,
                    "-P",
                    "-m",
                    fork_server_process.__name__,
                    preload,
                    *map(str, sockets),
                ],
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
