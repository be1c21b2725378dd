# SPDX-License-Identifier: Apache-2.0
"""What a process of a flight does until its first step, phase by phase, as JSON.

    ./flock python benchmarks/phases.py 13 $(date +%s.%N)

The birds of a flock fly in this process, and so does their clock; no other process is needed. The
second argument is the time at which the process was started; start.py gives it, and makes a table.
"""

import resource
import sys
import time

STEPS = 10


class Phases:
    """The wall time and the processor time of each phase, in s, by its name."""

    def __init__(self, started: float) -> None:
        self.spent: dict[str, tuple[float, float]] = {}
        self._last = started, 0.0

    def end(self, name: str) -> None:
        """End the phase `name`, which has begun as the one before it ended."""
        used = resource.getrusage(resource.RUSAGE_SELF)
        now = time.time(), used.ru_utime + used.ru_stime
        self.spent[name] = now[0] - self._last[0], now[1] - self._last[1]
        self._last = now


phases = Phases(float(sys.argv[2]))
phases.end("Python")

import json  # noqa: E402

import flock_sim.nodes.bird_process as bird_node  # noqa: E402
import flock_sim.nodes.clock as clock_node  # noqa: E402
from flock_sim.configuration.flock_configuration import FlockConfiguration  # noqa: E402
from flock_sim.launcher.flight import WINDOW  # noqa: E402
from flock_sim.launcher.precompile import warm_bird, warm_exchange  # noqa: E402
from flock_sim.messages import topics  # noqa: E402
from flock_sim.messages.epochs import first_epoch  # noqa: E402
from flock_sim.protocol.clock import Timekeeper, new_run_id  # noqa: E402
from flock_sim.ros.process import executing  # noqa: E402
from flock_sim.ros.watchdog import Watchdog  # noqa: E402
from flock_tools import testing  # noqa: E402

phases.end("imports")


def main() -> None:
    """Fly some steps, and print the phases."""
    configuration = FlockConfiguration(birds=int(sys.argv[1]), t_max=float(STEPS))
    warm_bird()
    warm_exchange()
    phases.end("loading kernels")
    with testing.ros_alone() as context:
        phases.end("ROS context")
        _fly(configuration, context)
    print(json.dumps(phases.spent))


def _fly(configuration: FlockConfiguration, context: object) -> None:
    run_id, over = new_run_id(), testing.Over()
    first = first_epoch()
    keeper = Timekeeper(configuration, run_id, WINDOW, False, False, first)
    with executing("events", context) as of_clock, executing("events", context) as of_birds:
        depth = topics.depth(topics.CLOCK_TOPIC, configuration)
        clock = clock_node.ClockNode(keeper, depth, context=context)
        of_clock.add_node(clock)
        birds = bird_node.create_birds(
            range(1, configuration.birds + 1), configuration, run_id, of_birds
        )
        phases.end("creating nodes")

        def watchdog() -> Watchdog:
            return Watchdog(60.0, lambda line: None)

        def watch() -> bool:
            if keeper.begun and "until the first step" not in phases.spent:
                phases.end("until the first step")
            return False

        part = testing.Part(
            "the birds", over, lambda: bird_node.fly_together(birds, of_birds, over, watchdog())
        )
        with testing.ended_together([part], over):
            clock_node.keep_time(clock, of_clock, watchdog(), watch)
            watch()
            clock.release()


if __name__ == "__main__":
    main()
