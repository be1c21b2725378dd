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
from dataclasses import dataclass, field
from types import TracebackType

from flock_sim import configuration_file
from flock_sim.command_line import note
from flock_sim.errors import RunFailed

SUPERVISED = "FLOCK_SUPERVISED"
"""Holds their parent's id in the environment of the processes of a crew."""

GRACE = 3.0
"""Time, in s, that a process has to end in order before it is killed."""


MOST_DEATHS = 5
"""How often a process may be killed, with no progress in between, before the flight is given up."""


STOPPED = 128
"""Exit statuses from here on are of processes that somebody has ended, by the signal's number."""


@dataclass
class _Hand:
    who: str
    command: list[str]
    parameters: tuple[int, int]  # descriptors of its files of parameters
    to_the_end: bool
    deaths: int = 0  # since the flight has come to `progress`
    progress: int = -1
    process: subprocess.Popen[bytes] = field(init=False)


class Crew:
    """A group of node processes; leaving the context ends those that still run."""

    def __init__(self, parameters: Mapping[str, object], respawn: bool = False) -> None:
        """Give every process the ROS `parameters`, besides those of its own.

        `respawn`: start those again that were killed.
        """
        self._parameters = _file(parameters)
        self._respawn = respawn
        self._hands: list[_Hand] = []
        self.deaths = 0
        """How many processes were killed, and started again."""

    def start(
        self, who: str, module: str, parameters: Mapping[str, object], *, to_the_end: bool = False
    ) -> None:
        """Start `module` with ROS `parameters`; `who` is what it is called in messages.

        `to_the_end`: it has something to do when the flight is over, and must end well.
        """
        files = (self._parameters, _file(parameters))
        command = [sys.executable, "-P", "-m", module, "--ros-args", "--disable-external-lib-logs"]
        for file in files:
            command += ["--params-file", f"/proc/self/fd/{file}"]
        hand = _Hand(who, command, files, to_the_end)
        with _interrupt_deferred():
            _run(hand)
            self._hands.append(hand)

    def check(self, progress: int = 0) -> None:
        """Start again who was killed; raise RunFailed if somebody ended otherwise than well.

        `progress` tells how far the flight has come: who is killed again and again, before it comes
        any further, is not started again for ever.
        """
        for hand in self._hands:
            if status := hand.process.poll():
                self._start_again(hand, status, progress)

    def _start_again(self, hand: _Hand, status: int, progress: int) -> None:
        if not self._respawn or 0 < status < STOPPED:
            raise RunFailed(f"{hand.who} {_ended(status)}")
        if progress > hand.progress:
            hand.progress, hand.deaths = progress, 0
        hand.deaths += 1
        if hand.deaths > MOST_DEATHS:
            raise RunFailed(
                f"{hand.who} {_ended(status)}, {hand.deaths} times without any progress in between"
            )
        self.deaths += 1
        note(f"{hand.who} {_ended(status)}: started again")
        with _interrupt_deferred():
            _run(hand)

    def join(self, timeout: float) -> None:
        """Wait until all have ended, well if they had to; raise RunFailed after `timeout` s.

        Who has nothing to do at the end only has a note written, and is killed as the context ends.
        """
        deadline = time.monotonic() + timeout
        while running := [hand for hand in self._hands if hand.process.poll() is None]:
            self._check_at_end()
            if time.monotonic() > deadline:
                late = f"did not end within {timeout:g} s of the flight's end"
                if needed := [hand.who for hand in running if hand.to_the_end]:
                    raise RunFailed(f"{' and '.join(needed)} {late}")
                note(f"{' and '.join(hand.who for hand in running)} {late}: ended by force")
                return
            time.sleep(0.005)  # a poll of processes, which nothing announces
        self._check_at_end()

    def _check_at_end(self) -> None:
        """Do as `check`; but nobody needs those any more who have nothing to do at the end."""
        for hand in self._hands:
            status = hand.process.poll()
            if status and not (self._respawn and (status < 0 or status >= STOPPED)):
                raise RunFailed(f"{hand.who} {_ended(status)}")
            if status and hand.to_the_end:
                self._start_again(hand, status, 0)

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
        for file in {file for hand in self._hands for file in hand.parameters}:
            os.close(file)
        self._hands.clear()

    def __enter__(self) -> Crew:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.stop()


def _run(hand: _Hand) -> None:
    environment = {**os.environ, SUPERVISED: str(os.getpid())}
    hand.process = subprocess.Popen(
        hand.command, stdin=subprocess.DEVNULL, env=environment, pass_fds=hand.parameters
    )


def _file(parameters: Mapping[str, object]) -> int:
    """Return the descriptor of a file of ROS parameters, which is gone with those who have it open.

    In a file, since ROS would read values on the command line as YAML; in memory, since nobody
    would be left to remove it after a kill.
    """
    descriptor = os.memfd_create("flock-parameters")
    with os.fdopen(os.dup(descriptor), "w", encoding="utf-8") as file:
        file.write(configuration_file.text(parameters))
    return descriptor


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
