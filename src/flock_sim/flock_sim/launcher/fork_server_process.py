# SPDX-License-Identifier: Apache-2.0
"""The process of a fork server: it forks programs on request, and reports their exit statuses."""

from __future__ import annotations

import atexit
import fcntl
import importlib
import json
import os
import select
import signal
import socket
import struct
import sys
import weakref
from contextlib import suppress

from flock_sim.console.signals import ENDING
from flock_sim.launcher.forkable import CannotFork, check_forkable
from flock_sim.launcher.forked_program import SPARE, run, show

MOST_BYTES = 1 << 20
"""Longest message between a server and its clients, in bytes."""


def serve_after_fork(connection: socket.socket) -> None:
    """Serve `connection` in this copy of the process that has made it."""
    _forget_ends()
    _Server(_keep_only(connection)).serve()


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
        show(__name__)
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
            run(json.loads(data), received, server)
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
