# SPDX-License-Identifier: Apache-2.0
"""Tools whose I/O calls on the files below one directory fail, by a library of failing_io.c."""

from __future__ import annotations

import errno
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from flock_sim.launcher.fork_server import ForkServer
from support.forked import spawn_server
from support.terminal import Done, Terminal

SOURCE = Path(__file__).with_suffix(".c")

SHORT = -1
"""Instead of an error number: a write stores half of its bytes."""

LAST = 10**9
"""More calls than any tool makes."""


@dataclass(frozen=True)
class Fault:
    """How calls fail: with `error` where it can be their result, and otherwise with `instead`."""

    error: int
    instead: int = 0
    """An error number; 0: the call succeeds."""
    lasting: bool = False
    """Whether all calls from the first one on fail, or that call only."""


class Call(NamedTuple):
    """A call of a tool."""

    number: int
    """From 1 on, over all processes of the tool."""
    name: str
    path: Path
    can: bool
    """Whether the error of the fault can be its result."""
    error: int
    """The error number that it was given; 0: none."""


class FailingIO:
    """Runs tools on a terminal. The calls on files below the directory `below` can fail."""

    def __init__(self, terminal: Terminal, server: ForkServer, below: Path) -> None:
        self._terminal, self._server, self._below = terminal, server, below
        self._state = terminal.directory.parent / "failing-io"
        self._state.mkdir()

    def run(
        self, tool: str, *arguments: object, fault: Fault, first: int
    ) -> tuple[Done, list[Call]]:
        """Run a tool whose call `first` fails; return its end and its calls. 0: none fails."""
        counter, log = self._state / "counter", self._state / "log"
        counter.write_bytes(bytes(8))
        log.write_bytes(b"")
        last = LAST if fault.lasting and first else first
        numbers = (first, last, fault.error, fault.instead)
        text = " ".join(map(str, (*numbers, counter, log, self._below)))
        environment = {**self._terminal.environment, "FAILING_IO": text}
        done = self._terminal.start(tool, *arguments, server=self._server, env=environment).wait()
        lines = [line.split(" ") for line in log.read_text(encoding="utf-8").splitlines()]
        calls = [
            Call(int(number), name, Path(path), can == "1", int(error))
            for number, name, path, can, error in lines
        ]
        return done, calls


@contextmanager
def failing_server(directory: Path) -> Iterator[ForkServer]:
    """Compile the library in `directory`, and give a server of tools that have loaded it."""
    library = directory / "failing_io.so"
    subprocess.run(
        ["g++", "-x", "c", "-shared", "-fPIC", "-O1", "-o", library, SOURCE, "-ldl"], check=True
    )
    server = spawn_server({"LD_PRELOAD": str(library)})
    try:
        yield server
    finally:
        server.close()


ERRORS = {
    "one call": Fault(errno.ENOSPC, errno.EIO),
    "a full disk": Fault(errno.ENOSPC, lasting=True),
    "a full quota": Fault(errno.EDQUOT, lasting=True),
    "a dead disk": Fault(errno.EIO, lasting=True),
    "a read-only disk": Fault(errno.EROFS, lasting=True),
    "no descriptors": Fault(errno.EMFILE, lasting=True),
}
"""The faults that tests try at each call."""
