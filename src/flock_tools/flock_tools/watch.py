# SPDX-License-Identifier: Apache-2.0
"""A live table of a flock that is flown or played: `flock watch`."""

from __future__ import annotations

import os
import re
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import rclpy
from rclpy.context import Context
from rclpy.executors import Executor
from rclpy.node import Node
from rich.console import Console
from rich.live import Live
from rich.table import Table

from flock_interfaces.msg import BirdState, Grant
from flock_sim.command_line import Parser, positive_number, print_json, run_tool, whole_number
from flock_sim.core import topics
from flock_sim.discovery import DOMAIN, NETWORK_HELP, prepare_discovery
from flock_sim.errors import FlockError, RunFailed
from flock_sim.nodes.endpoints import latched
from flock_sim.nodes.process import executing, ros_context
from flock_sim.shared_memory import remove_orphans
from flock_sim.standard_output import results_only_on_stdout
from flock_sim.stop import Stop
from flock_tools.watch_view import Sample, View

DESCRIPTION = """\
Show a flock that is flown or played, bird by bird, in the terminal: where it is relative to the
leader, how fast, how much drag it saves, whom it hears, and how old the last word of it is. The
latest recorded step is shown; states are sent every --record-every steps. Drag saved, coupling and
the end of the flight are told by the clock's grants: bags of ./flock reference have none.
Exit status: 0 shown (--once, --json); 1 nothing heard within --timeout; 2 bad input; 130 Ctrl-C."""

EXAMPLES = """\
  ./flock watch
  ./flock watch --member 2
  ./flock watch --once
  ./flock watch --json | jq .speed          one sample, as JSON"""

REFRESH = 0.25
"""Time, in s, between two pictures, and between two looks for topics."""

SETTLED = 1.0
"""Time, in s, without a new bird after which all are taken to be found, where no clock tells."""

DEPTH = 64
"""States of a bird that wait to be read; a flock that is faster than we read is sampled."""

STATE_TOPIC = re.compile(re.escape(topics.NAMESPACE) + r"/bird_(\d+)/state")


class Watcher(Node):
    """Listens to the states of whatever birds there are, and to the grants of their clock."""

    def __init__(self, context: Context) -> None:
        """Find nothing yet."""
        super().__init__(
            f"watch_{os.getpid()}",
            namespace=topics.NAMESPACE,
            context=context,
            start_parameter_services=False,
            enable_rosout=False,
        )
        self.view = View()
        self.birds: set[int] = set()
        self._found_at = 0.0
        self.create_subscription(
            Grant, topics.GRANT_TOPIC, self.view.hear_grant, latched(1), raw=True
        )
        self.create_timer(REFRESH, self.look_around)

    def look_around(self) -> None:
        """Listen to birds that were not there before."""
        for name, _ in self.get_topic_names_and_types():
            match = STATE_TOPIC.fullmatch(name)
            if match and int(match[1]) not in self.birds:
                self._listen(int(match[1]), name)

    def knows(self, sample: Sample) -> bool:
        """Whether nothing more is to be learned: a grant, or that there is none nor more birds."""
        if sample.coupling is not None:
            return True
        settled = time.monotonic() - self._found_at > SETTLED
        return settled and self.count_publishers(topics.GRANT_TOPIC) == 0

    def _listen(self, bird: int, topic: str) -> None:
        def hear(data: bytes) -> None:
            self.view.hear_state(bird, data)

        self.birds.add(bird)
        self._found_at = time.monotonic()
        self.create_subscription(BirdState, topic, hear, latched(DEPTH), raw=True)


def table(sample: Sample) -> Table:
    """Return the picture of a flock as people read it."""
    title = f"{sample.birds} birds" + (f", {sample.coupling} coupling" if sample.coupling else "")
    if sample.members > 1:
        title += f", member {sample.member} of {sample.members}"
    end = "" if sample.end is None else f" of {sample.end}"
    rate = "" if sample.rate is None else f", {sample.rate:.0f} steps/s"
    drawn = Table(title=f"{title}\nstep {sample.step}{end}, t = {sample.time:g}{rate}")
    known = sample.drag_reduction is not None
    drag = [] if known else sample.interaction_drag
    columns = {
        "bird": [
            f"{k + 1}{' leader' if k + 1 == sample.leader else ''}" for k in range(sample.birds)
        ],
        "position": [f"{value:.4f}" for value in sample.position],
        "speed": [f"{value:.6f}" for value in sample.speed],
        "drag saved, %": [f"{100.0 * value:.2f}" for value in sample.drag_reduction or ()],
        "drag saved": [f"{0.0 - value:.5f}" for value in drag],
        "hears": [_listed(birds) for birds in sample.hears or ()],
        "age, s": [f"{value:.1f}" for value in sample.age],
    }
    shown = {name: cells for name, cells in columns.items() if cells}
    for name in shown:
        drawn.add_column(name, justify="right")
    for cells in zip(*shown.values(), strict=True):
        drawn.add_row(*cells)
    if not known:
        drawn.caption = "no clock has told what is flown: drag is in ρ b² U_min²"
    return drawn


def _listed(birds: Sequence[int]) -> str:
    """Return who is heard, in few words."""
    return ", ".join(map(str, birds)) if len(birds) <= 2 else f"all {len(birds)}"


def tool(arguments: Sequence[str]) -> int:
    """Watch a flock until Ctrl-C, or once."""
    parser = Parser("watch", DESCRIPTION, EXAMPLES)
    parser.add_argument("--member", metavar="M", default="1", help="which member to show (1)")
    parser.add_argument("--once", action="store_true", help="print one table, and end")
    parser.add_argument("--json", action="store_true", help="print one sample as JSON, and end")
    parser.add_argument(
        "--timeout", metavar="S", default="10", help="how long to wait for a flock, in s (10)"
    )
    parser.add_argument("--network", action="store_true", help=NETWORK_HELP)
    options = parser.parse_args(arguments)
    member = whole_number("--member", options.member, 1)
    timeout = positive_number("--timeout", options.timeout)
    once = options.once or options.json
    if not once and not sys.stderr.isatty():
        raise FlockError("a live table needs a terminal: add --once or --json")
    prepare_discovery(options.network)
    stop = Stop(heed_interrupt=True)
    with results_only_on_stdout(), _watcher() as (watcher, executor):
        sample = _first(watcher, executor, member, timeout, stop)
        if sample is not None and not once:
            _show(watcher, executor, member, sample, stop)
    if sample is not None and options.json:
        print_json(sample.as_json())
    elif sample is not None and once:
        Console().print(table(sample))
    return stop.exit_status


@contextmanager
def _watcher() -> Iterator[tuple[Watcher, Executor]]:
    context = ros_context(["--ros-args", "--disable-external-lib-logs"])
    alone = True
    try:
        with executing("single", context) as executor:
            watcher = Watcher(context)
            executor.add_node(watcher)
            try:
                yield watcher, executor
            finally:
                alone = not watcher.birds
    finally:
        rclpy.try_shutdown(context=context)
        if alone:  # else a bird may have our port mapped, and whoever gets it next be deaf to it
            remove_orphans()


def _first(
    watcher: Watcher, executor: Executor, member: int, timeout: float, stop: Stop
) -> Sample | None:
    """Return the first sample; None on `stop`. Raises RunFailed where none comes in time."""
    deadline = time.monotonic() + timeout
    while not stop:
        sample = watcher.view.sample(watcher.birds, 1)
        if sample is not None and watcher.knows(sample):
            return watcher.view.sample(watcher.birds, member)
        if time.monotonic() > deadline:
            if sample is not None:
                return watcher.view.sample(watcher.birds, member)
            heard = f"only birds {sorted(watcher.birds)}" if watcher.birds else "no flock"
            raise RunFailed(
                f"{heard} heard within {timeout:g} s on ROS domain {os.environ.get(DOMAIN) or 0}:"
                f" fly or play one there, set {DOMAIN} to its domain, or give a longer --timeout"
            )
        executor.spin_once(timeout_sec=0.1)
    return None


def _show(
    watcher: Watcher, executor: Executor, member: int, sample: Sample | None, stop: Stop
) -> None:
    """Keep the table up to date until `stop`."""
    with Live(console=Console(stderr=True), auto_refresh=False) as live:
        while not stop:
            if sample is not None:
                live.update(table(sample), refresh=True)
            until = time.monotonic() + REFRESH
            while not stop and (left := until - time.monotonic()) > 0.0:
                executor.spin_once(timeout_sec=left)
            sample = watcher.view.sample(watcher.birds, member)


def main() -> int:
    """Run the `watch` executable."""
    return run_tool(tool)


if __name__ == "__main__":
    sys.exit(main())
