# SPDX-License-Identifier: Apache-2.0
"""A recorded flight, published again: `flock play RUN`."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from flock_sim.console.arguments import Parser, not_negative_number, note, print_json, run_tool
from flock_sim.console.signals import Stop
from flock_sim.ros.discovery import NETWORK_HELP, prepare_discovery

DESCRIPTION = """\
Publish what was recorded again: the same bytes, by their log time, on the same topics with the
quality of service that they were recorded with. Any rosbag2 bag in MCAP files will do, compressed
or not; what is not of a message type of an installed package, or not what its topic is announced to
be, is left out, and named. After --start or a seek, what latched topics said last before is said
first. /clock is played where it was recorded, as in every bag of Flock's; nothing is made up where
it was not.

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


def tool(arguments: Sequence[str]) -> int:
    """Play a bag, and print a summary."""
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
    rate = not_negative_number("--rate", options.rate)
    prepare_discovery(options.network)

    from flock_sim.bag.reading.reader import BagReader
    from flock_tools.runs.replay import play

    stop = Stop(heed_interrupt=True)
    with BagReader(options.run) as bag:
        if bag.missing:
            note(f"note: {bag.missing}; what is whole of it is played")
        for name in bag.left_out:
            note(f"note: {name} is left out: metadata.yaml does not list it")
        facts = play(bag, options, rate, stop)
    if options.json:
        print_json(facts)
    else:
        print(f"played {facts['messages']} messages of {len(facts['topics'])} topics")
    return stop.exit_status


def main() -> int:
    """Run the `play` executable."""
    return run_tool(tool)


if __name__ == "__main__":
    sys.exit(main())
