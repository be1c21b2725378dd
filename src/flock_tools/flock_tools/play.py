# SPDX-License-Identifier: Apache-2.0
"""A recorded flight, published again: `flock play RUN`."""

from __future__ import annotations

import gc
import math
import sys
from argparse import Namespace
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from threading import Thread
from typing import Any

import rclpy
from rclpy.context import Context

from flock_sim.bag.reader import BagReader
from flock_sim.command_line import LONGEST, Parser, note, positive_number, print_json, run_tool
from flock_sim.discovery import NETWORK_HELP, prepare_discovery
from flock_sim.errors import FlockError
from flock_sim.nodes.departure import leave
from flock_sim.nodes.process import executing, ros_context
from flock_sim.progress import playback_bar
from flock_sim.standard_output import results_only_on_stdout
from flock_sim.stop import Stop
from flock_tools.keyboard import DOWN, QUIT, RIGHT, SPACE, UP, keyboard
from flock_tools.play_schedule import BILLION, Schedule
from flock_tools.play_topics import Selection, select
from flock_tools.playback import Playback, Recorded
from flock_tools.player import Player

DESCRIPTION = """\
Publish what was recorded again: the same bytes, in the order of the bag, on the same topics with
the quality of service that they were recorded with. Any rosbag2 bag in MCAP files will do; topics
whose type can't be imported here are left out, and named. /clock is played where it was recorded,
as in every bag of Flock's; nothing is made up where it was not.

On a terminal: space pauses, the right arrow plays the next message in a pause, up and down change
the rate by a tenth, q ends it. The node /flock/player has the services of rosbag2's player:
~/pause, ~/resume, ~/toggle_paused, ~/is_paused, ~/set_rate, ~/get_rate, ~/seek, ~/play_next and
~/stop.

Recorded states say run 0, and no flight takes them for its own: ./flock recorder records them if
told that they are played (-p played:=true). Nodes started by hand that wait for their clock take a
played grant for it: play on another ROS_DOMAIN_ID than theirs.
Exit status: 0 played to the end, or stopped by q or ~/stop; 2 bad input; 130 Ctrl-C."""

EXAMPLES = """\
  ./flock play runs/demo --rate 1000
  ./flock play runs/demo --start 20 --duration 5 --loop
  ./flock play runs/demo --rate 0 --topics /clock /flock/bird_07/state
  ./flock play runs/demo --paused        and then, in another terminal:
  ros2 service call /flock/player/resume rosbag2_interfaces/srv/Resume"""

KEYS = "space: pause or go on   right: next message   up, down: rate   q: end"

FASTER = 1.1
"""What a press of the up arrow multiplies the rate by."""


def tool(arguments: Sequence[str]) -> int:
    """Play a bag, and say what was played."""
    parser = Parser("play", DESCRIPTION, EXAMPLES)
    parser.add_argument("run", metavar="RUN", type=Path, help="directory of a bag, or .mcap file")
    parser.add_argument(
        "--rate", metavar="X", default="1", help="recorded seconds in a second (1); 0: no waiting"
    )
    parser.add_argument(
        "--start", metavar="S", default="0", help="begin so many recorded seconds after the first"
    )
    parser.add_argument("--duration", metavar="S", help="play so many recorded seconds (all)")
    parser.add_argument("--loop", action="store_true", help="begin again at the end, until stopped")
    parser.add_argument("--paused", action="store_true", help="begin in a pause")
    parser.add_argument("--topics", metavar="T", nargs="+", help="play these only")
    parser.add_argument("--network", action="store_true", help=NETWORK_HELP)
    parser.add_argument("--json", action="store_true", help="print what was played as JSON")
    options = parser.parse_args(arguments)
    rate = _not_negative("--rate", options.rate)
    prepare_discovery(options.network)
    stop = Stop(heed_interrupt=True)
    with BagReader(options.run) as bag:
        if bag.missing:
            note(f"note: {bag.missing}; what is whole of it is played")
        facts = play(bag, options, rate, stop)
    if options.json:
        print_json(facts)
    else:
        print(f"played {facts['messages']} messages of {len(facts['topics'])} topics")
    return stop.exit_status


def play(bag: BagReader, options: Namespace, rate: float, stop: Stop) -> dict[str, Any]:
    """Play `bag` as `options` say until its end or `stop`; return what was played.

    Raises FlockError where nothing of it is to be played.
    """
    span, read = _extract(bag, options)
    selection = select(bag, options.topics)
    for name, reason in selection.skipped.items():
        note(f"note: {name} is left out: {reason}")
    start = round(_not_negative("--start", options.start) * BILLION)
    begin = span[0] + start if start else None
    schedule = Schedule(span[0] + start, rate, paused=options.paused)
    with results_only_on_stdout(), _player(selection) as (player, spin):
        playback = Playback(
            lambda at: read(selection, at),
            player.say_when_heard if rate == 0.0 else player.say,
            schedule,
            span,
            meet=lambda: player.meet(stop),
            begin=begin,
            loop=options.loop,
        )
        if playback.empty:
            raise FlockError(
                f"{bag.path}: nothing was recorded on these topics from {start / BILLION:g} s on"
                " for as long as --duration says: choose others"
            )
        player.serve(playback)
        spin()
        gc.freeze()  # nothing of what is here by now is looked through again, for milliseconds
        try:
            schedule.jump(span[0] + start)
            _run(playback, span, stop)
            player.wait_until_heard(stop)
        finally:
            gc.unfreeze()
    return {
        "run": str(options.run),
        "messages": playback.played.total(),
        "topics": {name: playback.played[name] for name in selection.topics},
        "skipped": dict(selection.skipped),
        "rate": schedule.rate,
        "reached": playback.reached,
    }


def _extract(
    bag: BagReader, options: Namespace
) -> tuple[tuple[int, int], Callable[[Selection, int | None], Iterator[Recorded]]]:
    """Return the first and last recorded time to play, in ns, and how to read from a time on."""
    first = next((stamp for _, stamp, _ in bag.messages()), None)
    if first is None or bag.last_time is None:
        raise FlockError(f"{bag.path}: there is no message in it; name another bag")
    last = max(first, bag.last_time)
    length = (last - first) / BILLION
    start = _not_negative("--start", options.start)
    if start > length:
        raise FlockError(f"--start {options.start}: must be {length:g} or less, where the bag ends")
    end = None
    if options.duration is not None:
        end = first + round((start + positive_number("--duration", options.duration)) * BILLION) + 1
        last = min(last, end - 1)

    def read(selection: Selection, at: int | None) -> Iterator[Recorded]:
        return bag.messages(selection.topics.keys(), at, end)

    return (first, last), read


@contextmanager
def _player(selection: Selection) -> Iterator[tuple[Player, Callable[[], None]]]:
    """Give the node, and what has its services served from then on, in another thread."""
    context: Context = ros_context(["--ros-args", "--disable-external-lib-logs"])
    try:
        with executing("single", context) as executor:
            player = Player(selection.topics, context)
            executor.add_node(player)
            thread = Thread(target=executor.spin, daemon=True)
            try:
                yield player, thread.start
            finally:
                executor.shutdown()
                if thread.ident is not None:
                    thread.join()
                leave(context, [player])  # the executor, shut down, knows it no more
    finally:
        rclpy.try_shutdown(context=context)


def _run(playback: Playback, span: tuple[int, int], stop: Stop) -> None:
    """Play, and heed keys and signals meanwhile."""
    schedule = playback.schedule
    length = (span[1] - span[0]) / BILLION
    with keyboard(lambda: note(KEYS)) as pressed, playback_bar(length) as show:

        def look() -> None:
            for key in pressed():
                if key == SPACE:
                    playback.toggle_paused()
                elif key == RIGHT:
                    playback.play_next()
                elif key in (UP, DOWN):
                    playback.set_rate(schedule.rate * (FASTER if key == UP else 1.0 / FASTER))
                elif key == QUIT:
                    playback.stop()
            if stop:
                playback.stop()
            show(playback.reached, schedule.rate, schedule.paused)

        playback.run(look)


def _not_negative(name: str, text: str) -> float:
    """Return `text` as a finite number, 0 or more. Raises FlockError otherwise."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0.0 <= value <= LONGEST:
        raise FlockError(f"{name} {text}: must be a number from 0 to {LONGEST:g}")
    return value


def main() -> int:
    """Run the `play` executable."""
    return run_tool(tool)


if __name__ == "__main__":
    sys.exit(main())
