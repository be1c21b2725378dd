# SPDX-License-Identifier: Apache-2.0
"""A live table of a flock that is flown or played: `flock watch`."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from threading import Event
from typing import TYPE_CHECKING

from flock_sim.console.arguments import Parser, positive_number, print_json, run_tool, whole_number
from flock_sim.console.signals import Stop
from flock_sim.console.stdout import results_only_on_stdout
from flock_sim.errors import FlockError
from flock_sim.outside.printing import one_line
from flock_sim.ros.discovery import NETWORK_HELP, prepare_discovery
from flock_sim.ros.ros_arguments import split

if TYPE_CHECKING:
    from rclpy.executors import Executor
    from rich.table import Table

    from flock_tools.live.flock_monitor import Sample
    from flock_tools.live.listener import Watcher

DESCRIPTION = """\
Show a live table of a flock that is flown or played. It has a row for each bird: its position
relative to the leader, its speed, the drag it saves, the birds whose messages it uses ("hears"),
and the age of its last message. Above are the spread of the speeds, sigma_U, and a verdict from
all states that were seen since the table was opened (docs/model.md). The table shows the latest
recorded step: birds send their states every --record-every steps. The verdict, the drag saved in %,
the coupling and the end of the flight need the messages of a clock; bags of ./flock reference
have none.
Keys: q quits, the left and right arrows show another member.
Exit status: 0 ended by q, or shown once (--once, --json); 1 no flock within --timeout; 2 bad input;
130 Ctrl-C."""

EXAMPLES = """\
  ./flock watch
  ./flock watch --member 2
  ./flock watch --once
  ./flock watch --json | jq .speed          one sample, as JSON"""


KEYS = "q: quit"
MEMBER_KEYS = "left and right arrow: another member"


def table(sample: Sample, unreadable: str = "", verdict: str = "", keys: str = "") -> Table:
    """Return the table of a flock, with the `verdict` above and the `keys` below.

    `unreadable`: why the clock's configuration can't be read.
    """
    from rich.markup import escape
    from rich.table import Table

    from flock_sim.analysis.metrics import STABLE_BELOW

    title = f"{sample.birds} birds" + (f", {sample.coupling} coupling" if sample.coupling else "")
    if sample.real_time_factor:
        title += f", flown freely at real-time factor {sample.real_time_factor:g}"
    if sample.members > 1:
        title += f", member {sample.member} of {sample.members}"
    end = "" if sample.end is None else f" of {sample.end}"
    rate = "" if sample.rate is None else f", {sample.rate:.0f} steps/s"
    mean = sum(sample.speed) / sample.birds
    stable = f"{'below' if sample.speed_std < STABLE_BELOW else 'not below'} {STABLE_BELOW:g}"
    lines = [
        title,
        f"step {sample.step}{end}, t = {sample.time:g} b/U_min{rate}",
        f"mean speed {mean:.6f} U_min, sigma_U {sample.speed_std:.2e} U_min ({stable})",
        *([f"verdict: {verdict}"] if verdict else []),
    ]
    drawn = Table(title="\n".join(lines))
    known = sample.drag_reduction is not None
    drag = [] if known else sample.interaction_drag
    columns = {
        "bird": [
            f"{k + 1}{' leader' if k + 1 == sample.leader else ''}" for k in range(sample.birds)
        ],
        "position, b": [f"{value:.4f}" for value in sample.position],
        "speed, U_min": [f"{value:.6f}" for value in sample.speed],
        "drag saved, %": [f"{100.0 * value:.2f}" for value in sample.drag_reduction or ()],
        "drag saved, ρ b² U_min²": [f"{0.0 - value:.5f}" for value in drag],
        "hears": [_listed(birds) for birds in sample.hears or ()],
        "age, s": [f"{value:.1f}" for value in sample.age],
    }
    filled = {name: cells for name, cells in columns.items() if cells}
    for name in filled:
        drawn.add_column(name, justify="right")
    for cells in zip(*filled.values(), strict=True):
        drawn.add_row(*cells)
    notes = [keys] if keys else []
    if not known:
        why = "no clock has sent the configuration"
        if unreadable:
            reason = escape(one_line(unreadable))
            why = f"the configuration that the clock has sent can't be read ({reason})"
        notes.append(f"{why}: no verdict, and drag not in %")
    drawn.caption = "\n".join(notes) or None
    return drawn


def _listed(birds: Sequence[int]) -> str:
    """Return the heard birds as short text."""
    return ", ".join(map(str, birds)) if len(birds) <= 2 else f"all {len(birds)}"


def tool(arguments: Sequence[str]) -> int:
    """Show a flock until q or Ctrl-C, or once."""
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
    arguments, ros_arguments = split(arguments)
    options = parser.parse_args(arguments)
    member = whole_number("--member", options.member, 1)
    timeout = positive_number("--timeout", options.timeout)
    once = options.once or options.json
    if not once and not sys.stderr.isatty():
        raise FlockError("a live table needs a terminal: add --once or --json")
    prepare_discovery(options.network)
    stop = Stop(heed_interrupt=True)

    from flock_tools.live.listener import Watcher, first_sample, watching

    with results_only_on_stdout(), watching(Watcher, ros_arguments) as (watcher, executor):
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
    """Keep the table up to date until `stop`, or until the user presses q."""
    from rich.console import Console
    from rich.live import Live

    from flock_tools.live.listener import REFRESH, serve
    from flock_tools.live.running_verdict import RunningVerdict
    from flock_tools.playback.keyboard import LEFT, QUIT, RIGHT, keyboard

    verdict, has_keys = RunningVerdict(), Event()
    with (
        keyboard(has_keys.set) as pressed,
        Live(console=Console(stderr=True), auto_refresh=False) as live,
    ):
        while not stop:
            if sample is not None:
                verdict.see(sample)
                keys = [KEYS, MEMBER_KEYS] if sample.members > 1 else [KEYS]
                drawn = table(
                    sample,
                    watcher.view.unreadable,
                    verdict.told(watcher.view.flown),
                    "   ".join(keys) if has_keys.is_set() else "Ctrl-C: quit",
                )
                live.update(drawn, refresh=True)
            for key in pressed():
                if key == QUIT:
                    return
                if key in (LEFT, RIGHT) and sample is not None:
                    member = (member - 1 + (1 if key == RIGHT else -1)) % sample.members + 1
            serve(executor, REFRESH, stop)
            sample = watcher.view.sample(watcher.birds, member)


def main() -> int:
    """Run the `watch` executable."""
    return run_tool(tool)


if __name__ == "__main__":
    sys.exit(main())
