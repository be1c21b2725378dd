# SPDX-License-Identifier: Apache-2.0
"""A live table of a flock that is flown or played: `flock watch`."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING

from flock_sim.console.arguments import Parser, positive_number, print_json, run_tool, whole_number
from flock_sim.console.signals import Stop
from flock_sim.console.stdout import results_only_on_stdout
from flock_sim.errors import FlockError
from flock_sim.ros.discovery import NETWORK_HELP, prepare_discovery

if TYPE_CHECKING:
    from rclpy.executors import Executor
    from rich.table import Table

    from flock_tools.live.flock_monitor import Sample
    from flock_tools.live.listener import Watcher

DESCRIPTION = """\
Show a table of a flock that is being flown or played, with a row for each bird: its position
relative to the leader, its speed, the drag it saves, the birds whose messages it uses ("hears"),
and the age of its last message. The latest recorded step is shown; birds send states every
--record-every steps. Drag saved, coupling and the end of the flight come from the clock's grants,
which bags of ./flock reference do not have.
Exit status: 0 shown (--once, --json); 1 no flock within --timeout; 2 bad input; 130 Ctrl-C."""

EXAMPLES = """\
  ./flock watch
  ./flock watch --member 2
  ./flock watch --once
  ./flock watch --json | jq .speed          one sample, as JSON"""


def table(sample: Sample, unreadable: str = "") -> Table:
    """Return the table of a flock. `unreadable`: why the clock's configuration can't be read."""
    from rich.table import Table

    title = f"{sample.birds} birds" + (f", {sample.coupling} coupling" if sample.coupling else "")
    if sample.real_time_factor:
        title += f", flown freely at real-time factor {sample.real_time_factor:g}"
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
        why = "no clock has sent the configuration"
        if unreadable:
            why = f"the configuration that the clock has sent can't be read ({unreadable})"
        drawn.caption = f"{why}: drag is in ρ b² U_min²"
    return drawn


def _listed(birds: Sequence[int]) -> str:
    """Return the heard birds as short text."""
    return ", ".join(map(str, birds)) if len(birds) <= 2 else f"all {len(birds)}"


def tool(arguments: Sequence[str]) -> int:
    """Show a flock until Ctrl-C, or once."""
    parser = Parser("watch", DESCRIPTION, EXAMPLES)
    parser.add_argument(
        "--member", metavar="M", default="1", help="number of the member to show (1)"
    )
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

    from flock_tools.live.listener import Watcher, first_sample, watching

    with results_only_on_stdout(), watching(Watcher) as (watcher, executor):
        sample = first_sample(watcher, executor, member, timeout, stop)
        if sample is not None and not once:
            _show(watcher, executor, member, sample, stop)
    if sample is not None and options.json:
        print_json(sample.as_json())
    elif sample is not None and once:
        from rich.console import Console

        Console().print(table(sample, watcher.view.unreadable))
    return stop.exit_status


def _show(
    watcher: Watcher, executor: Executor, member: int, sample: Sample | None, stop: Stop
) -> None:
    """Keep the table up to date until `stop`."""
    from rich.console import Console
    from rich.live import Live

    from flock_tools.live.listener import REFRESH, serve

    with Live(console=Console(stderr=True), auto_refresh=False) as live:
        while not stop:
            if sample is not None:
                live.update(table(sample, watcher.view.unreadable), refresh=True)
            serve(executor, REFRESH, stop)
            sample = watcher.view.sample(watcher.birds, member)


def main() -> int:
    """Run the `watch` executable."""
    return run_tool(tool)


if __name__ == "__main__":
    sys.exit(main())
