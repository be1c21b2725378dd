# SPDX-License-Identifier: Apache-2.0
"""The processes of a composed flight: started together, watched, and never left behind."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType

from flock_sim import configuration_file
from flock_sim.errors import RunFailed
from flock_sim.shared_memory import remove_orphans

SUPERVISED = "FLOCK_SUPERVISED"
"""Holds their parent's id in the environment of the processes of a crew."""

GRACE = 3.0
"""Time, in s, that a process has to end in order before it is killed."""


@dataclass
class _Hand:
    who: str
    process: subprocess.Popen[bytes]


class Crew:
    """A group of node processes; leaving the context ends those that still run."""

    def __init__(self, parameters: Path) -> None:
        """Give every process the file `parameters`; beside it, each gets one of its own."""
        self._parameters = parameters
        self._hands: list[_Hand] = []

    def start(self, who: str, module: str, parameters: Mapping[str, object]) -> None:
        """Start `module` with ROS `parameters`; `who` is what it is called in messages."""
        # In a file: on the command line, ROS would read the values as YAML.
        own = self._parameters.with_name(f"{len(self._hands)}.yaml")
        own.write_text(configuration_file.text(parameters), encoding="utf-8")
        command = [sys.executable, "-P", "-m", module, "--ros-args", "--disable-external-lib-logs"]
        for file in (self._parameters, own):
            command += ["--params-file", str(file)]
        environment = {**os.environ, SUPERVISED: str(os.getpid())}
        with _interrupt_deferred():
            process = subprocess.Popen(command, stdin=subprocess.DEVNULL, env=environment)
            self._hands.append(_Hand(who, process))

    def check(self) -> None:
        """Raise RunFailed if a process ended otherwise than well."""
        for hand in self._hands:
            status = hand.process.poll()
            if status:
                raise RunFailed(f"{hand.who} {_ended(status)}")

    def join(self, timeout: float) -> None:
        """Wait until all have ended well; raise RunFailed after `timeout` s."""
        deadline = time.monotonic() + timeout
        while any(hand.process.poll() is None for hand in self._hands):
            self.check()
            if time.monotonic() > deadline:
                running = [hand.who for hand in self._hands if hand.process.poll() is None]
                raise RunFailed(
                    f"{' and '.join(running)} did not end within {timeout:g} s of the flight's end"
                )
            time.sleep(0.005)  # a poll of processes, which nothing announces
        self.check()

    def stop(self) -> None:
        """End every process that runs: in order if it can be, by force after GRACE."""
        running = [hand.process for hand in self._hands if hand.process.poll() is None]
        for process in running:
            process.send_signal(signal.SIGTERM)
            process.send_signal(signal.SIGCONT)
        deadline = time.monotonic() + GRACE
        for process in running:
            try:
                process.wait(max(0.0, deadline - time.monotonic()))
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        remove_orphans()

    def __enter__(self) -> Crew:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.stop()


@contextmanager
def _interrupt_deferred() -> Iterator[None]:
    """Hear of a Ctrl-C only after the block, so that no process is started and not known.

    Processes that are started in it inherit that they are deaf to it: told to by their own first
    lines, they would complain of the imports before them that are cut short.
    """
    heard: list[int] = []
    handler = signal.signal(signal.SIGINT, lambda number, frame: heard.append(number))
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        signal.signal(signal.SIGINT, handler)
    if heard and handler is not signal.SIG_IGN:
        raise KeyboardInterrupt


def _ended(status: int) -> str:
    if status > 0:
        return f"ended with status {status}"
    return f"was killed by {signal.Signals(-status).name}"
