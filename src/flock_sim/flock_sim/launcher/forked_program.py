# SPDX-License-Identifier: Apache-2.0
"""A program that a fork server runs in a new child: what is requested, and how the child begins."""

from __future__ import annotations

import fcntl
import importlib
import os
import signal
import sys
import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NoReturn

from flock_sim.console.signals import SUPERVISED, end_process, end_with_parent

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


def run(request: dict[str, Any], received: list[int], server: int) -> NoReturn:
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
        show(f"{program.module}:{program.name}")
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


def show(title: str) -> None:
    """Set the title that `ps` shows, if the library for it is installed."""
    try:
        from setproctitle import setproctitle
    except ImportError:
        return
    setproctitle(title)
