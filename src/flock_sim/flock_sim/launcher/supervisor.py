# SPDX-License-Identifier: Apache-2.0
"""The supervisor of a composed flight: it starts, watches and ends the node processes."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import TracebackType

from flock_sim.console.arguments import note
from flock_sim.console.signals import SUPERVISED, ending_deferred
from flock_sim.errors import RunFailed
from flock_sim.launcher.exit_status import ended, failed
from flock_sim.launcher.fork_server import Child, ForkServer
from flock_sim.launcher.forkable import CannotFork
from flock_sim.launcher.forked_program import Program

GRACE = 3.0
"""Time for a process to end in order before it is killed, in s."""


MOST_DEATHS = 5
"""Most restarts of a killed process without progress of the flight in between."""


@dataclass
class _ChildProcess:
    who: str
    module: str
    parameters: tuple[int, int]  # descriptors of its files of parameters
    to_the_end: bool
    ros_arguments: Sequence[str]
    deaths: int = 0  # since the flight reached `progress`
    progress: int = -1
    process: subprocess.Popen[bytes] | Child = field(init=False)

    @property
    def title(self) -> str:
        """Its name without spaces."""
        return self.who.removeprefix("the ").removeprefix("process of ").replace(" ", "-")

    @property
    def arguments(self) -> list[str]:
        """Its command line."""
        words = [*self.ros_arguments, "--ros-args"]
        for file in self.parameters:
            words += ["--params-file", f"/proc/self/fd/{file}"]
        return words


class Supervisor:
    """A group of node processes; the end of the context ends those that still run."""

    def __init__(
        self,
        parameters: Mapping[str, object],
        respawn: bool = False,
        server: ForkServer | None = None,
        ros_arguments: Sequence[str] = (),
    ) -> None:
        """Give every process the ROS `parameters`, in addition to its own, and `ros_arguments`.

        `respawn`: restart killed processes. `server` forks the processes and is closed at the end.
        Without one, or once it is gone, each process is a new one.
        """
        self._parameters = _file(parameters)
        self._respawn = respawn
        self._ros_arguments = ros_arguments
        self._server = server
        self._children: list[_ChildProcess] = []
        self.deaths = 0
        """Number of restarts of processes."""

    def start(
        self, who: str, module: str, parameters: Mapping[str, object], *, to_the_end: bool = False
    ) -> None:
        """Start `module` with ROS `parameters`; `who` is its name in notes and errors.

        `to_the_end`: it still has work when the flight is over, and must end with status 0.
        """
        files = self._parameters, _file(parameters)
        child = _ChildProcess(who, module, files, to_the_end, self._ros_arguments)
        with ending_deferred():
            child.process = self._run(child)
            self._children.append(child)

    def check(self, progress: int = 0) -> None:
        """Restart the processes that were killed or ended early. Raise RunFailed if one has failed.

        `progress` tells how far the flight has come: a process that ends MOST_DEATHS times without
        any is not restarted again.
        """
        for child in self._children:
            status = child.process.poll()
            if status is not None:
                self._start_again(child, status, progress)

    def _check_restart(self, child: _ChildProcess, status: int) -> None:
        """Raise RunFailed if a process that ended with `status` must not be restarted."""
        if not self._respawn or failed(status):
            raise RunFailed(f"{child.who} {ended(status)}")

    def _start_again(self, child: _ChildProcess, status: int, progress: int) -> None:
        self._check_restart(child, status)
        if progress > child.progress:
            child.progress, child.deaths = progress, 0
        child.deaths += 1
        if child.deaths > MOST_DEATHS:
            raise RunFailed(
                f"{child.who} {ended(status)}, {child.deaths} times without any progress in between"
            )
        self.deaths += 1
        note(f"{child.who} {ended(status)}: started again")
        with ending_deferred():
            child.process = self._run(child)

    def join(self, timeout: float) -> None:
        """Wait until all processes have ended, for `timeout` s at most.

        Raises RunFailed if a process started `to_the_end` is late, or if one has failed. Any other
        late process only causes a note; the end of the context kills it.
        """
        deadline = time.monotonic() + timeout
        while running := [child for child in self._children if child.process.poll() is None]:
            self._check_at_end()
            if time.monotonic() > deadline:
                late = f"did not end within {timeout:g} s of the flight's end"
                if needed := [child.who for child in running if child.to_the_end]:
                    raise RunFailed(f"{' and '.join(needed)} {late}")
                note(f"{' and '.join(child.who for child in running)} {late}: ended by force")
                return
            time.sleep(0.005)  # polls the processes: no event signals their ends
        self._check_at_end()

    def _check_at_end(self) -> None:
        """Do as `check`, but do not restart processes without work at the end."""
        for child in self._children:
            status = child.process.poll()
            if status:
                self._check_restart(child, status)
                if child.to_the_end:
                    self._start_again(child, status, 0)

    def stop(self) -> None:
        """End every running process: in order if possible, by force after GRACE."""
        running = [child.process for child in self._children if child.process.poll() is None]
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
        for file in {file for child in self._children for file in child.parameters}:
            os.close(file)
        self._children.clear()
        if self._server is not None:
            self._server.close()

    def _run(self, child: _ChildProcess) -> subprocess.Popen[bytes] | Child:
        """Start a process: forked by the server, or a new one without a server."""
        if self._server is not None:
            program = Program(child.module, child.arguments, child.title, supervised=True)
            with open(os.devnull, "rb") as nothing:
                files = {0: nothing.fileno(), 1: 1, 2: 2, **{f: f for f in child.parameters}}
                try:
                    return self._server.start(program, files)
                except CannotFork as error:
                    note(
                        "note: from now on processes start without the fork server, which is "
                        f"slower: {error}"
                    )
                    self._server.close()
                    self._server = None
        return subprocess.Popen(
            [sys.executable, "-P", "-m", child.module, *child.arguments],
            stdin=subprocess.DEVNULL,
            env={**os.environ, SUPERVISED: str(os.getpid())},
            pass_fds=child.parameters,
        )

    def __enter__(self) -> Supervisor:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.stop()


def _file(parameters: Mapping[str, object]) -> int:
    """Return the descriptor of a file in memory that holds ROS parameters.

    It is a file, since ROS would read values on the command line as YAML. It is in memory, so that
    it disappears with the processes that have it open, even after a kill.
    """
    from flock_sim.configuration import parameter_file  # with YAML

    descriptor = os.memfd_create("flock-parameters")
    with os.fdopen(os.dup(descriptor), "w", encoding="utf-8") as file:
        file.write(parameter_file.text(parameters))
    return descriptor
