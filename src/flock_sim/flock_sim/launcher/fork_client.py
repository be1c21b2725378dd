# SPDX-License-Identifier: Apache-2.0
"""A proxy for a process that a fork server forks: `ros2 launch` starts and watches this proxy.

    python -m flock_sim.launcher.fork_client ADDRESS .../flock_sim/bird --ros-args ...

The node gets the streams, the environment and the arguments of this process. This process forwards
signals to the node, and ends with its status. If this process is killed, the node is killed too.
Without a fork server, this process becomes the node.
"""

from __future__ import annotations

import os
import signal
import sys
from contextlib import suppress

from flock_sim.console.signals import ENDING
from flock_sim.launcher.fork_server import ForkServer
from flock_sim.launcher.forkable import CannotFork
from flock_sim.launcher.forked_program import Program
from flock_sim.nodes.executables import module_of


def main() -> None:
    """Let the server fork a node, and end with its status."""
    address, executable, *arguments = sys.argv[1:]
    name = os.path.basename(executable)
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, ENDING)  # until the node exists
    try:
        program = Program(module_of(name), arguments, "launched")
        child = ForkServer.connect(address).start(program, {0: 0, 1: 1, 2: 2})
    except CannotFork:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        os.execv(executable, [executable, *arguments])
    for number in ENDING:
        signal.signal(number, lambda number, frame: child.send_signal(number))
    signal.pthread_sigmask(signal.SIG_SETMASK, mask)
    status = child.wait()
    if status < 0:
        with suppress(OSError):  # the default of SIGKILL is fixed
            signal.signal(-status, signal.SIG_DFL)
        os.kill(os.getpid(), -status)
    sys.exit(status)


if __name__ == "__main__":
    main()
