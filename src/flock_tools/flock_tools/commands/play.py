# SPDX-License-Identifier: Apache-2.0
"""A recorded flight, published again: `flock play RUN`."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from flock_sim.console.arguments import Parser, not_negative_number, note, print_json, run_tool
from flock_sim.console.signals import Stop
from flock_sim.ros.discovery import NETWORK_HELP, prepare_discovery
from flock_sim.ros.ros_arguments import split

DESCRIPTION = """\
Publish the recorded messages again: the same bytes, by their log time, on the same topics, with
the recorded quality of service. Every rosbag2 bag of MCAP files can be played, compressed or not.
Messages whose type belongs to no installed package, or which do not fit the type of their topic,
are left out, and a note names them. After --start or a seek, the last earlier messages of latched
topics are published first. /clock is played if it was recorded, as in every bag of Flock; with
--clock the player publishes its own instead, and otherwise none. Options are named as those of
ros2 bag play; docs/flying.md tells what differs.

On a terminal: space pauses, the right arrow plays the next message in a pause, up and down change
the rate by a tenth, q ends it. The node /flock/player has the services of rosbag2's player:
~/pause, ~/resume, ~/toggle_paused, ~/is_paused, ~/set_rate, ~/get_rate, ~/seek, ~/play_next and
~/stop. Their types are those of rosbag2_interfaces where it is installed, and otherwise the copies
in flock_interfaces.

Recorded states have run id 0, so no flight accepts them; ./flock recorder records them with
-p played:=true. Nodes that you started by hand, and that wait for their clock, would accept a
played grant as the grant of their clock: play on another ROS_DOMAIN_ID than theirs.
Exit status: 0 played to the end, or stopped by q or ~/stop; 2 bad input; 130 Ctrl-C."""

EXAMPLES = """\
  ./flock play runs/demo --rate 1000
  ./flock play runs/demo --start 20 --duration 5 --loop
  ./flock play runs/demo --rate 0 --topics /clock /flock/bird_07/state
  ./flock play drive_bag --clock --remap /camera:=/old/camera --exclude-topics /rosout
  ./flock play runs/demo --paused        and then, in another terminal:
  ros2 service call /flock/player/resume flock_interfaces/srv/Resume"""


def tool(arguments: Sequence[str]) -> int:
    """Play a bag, and print a summary."""
    parser = Parser("play", DESCRIPTION, EXAMPLES)
    parser.add_argument("run", metavar="RUN", type=Path, help="directory of a bag, or .mcap file")
    parser.add_argument(
        "--rate",
        "-r",
        metavar="X",
        default="1",
        help="recorded seconds per second (1); 0: as fast as possible",
    )
    parser.add_argument(
        "--start",
        "--start-offset",
        "-s",
        metavar="S",
        default="0",
        help="begin S recorded seconds after the first message (0)",
    )
    parser.add_argument(
        "--duration", "--playback-duration", metavar="S", help="play S recorded seconds (all)"
    )
    parser.add_argument(
        "--loop", "-l", action="store_true", help="begin again at the end, until stopped"
    )
    parser.add_argument(
        "--paused", "--start-paused", "-p", action="store_true", help="begin paused"
    )
    parser.add_argument(
        "--delay", "-d", metavar="S", default="0", help="wait S s before each start, also of a loop"
    )
    parser.add_argument("--topics", metavar="T", nargs="+", help="play only these topics")
    parser.add_argument(
        "--exclude-topics", metavar="T", nargs="+", action="extend", help="do not play these topics"
    )
    parser.add_argument(
        "--remap",
        "-m",
        metavar="OLD:=NEW",
        nargs="+",
        action="extend",
        help="play the topic OLD of the bag under the name NEW",
    )
    parser.add_argument(
        "--clock",
        metavar="HZ",
        nargs="?",
        const="40",
        help="publish recorded time on /clock, HZ times a second (40), and not a recorded /clock",
    )
    parser.add_argument(
        "--disable-keyboard-controls", action="store_true", help="do not react to keys"
    )
    parser.add_argument("--network", action="store_true", help=NETWORK_HELP)
    parser.add_argument("--json", action="store_true", help="print a summary as JSON on stdout")
    arguments, ros_arguments = split(arguments)
    options = parser.parse_args(arguments)
    rate = not_negative_number("--rate", options.rate)
    prepare_discovery(options.network)

    from flock_sim.bag.reading.reader import BagReader
    from flock_tools.runs.replay import play

    stop = Stop(heed_interrupt=True)
    with BagReader(options.run) as bag:
        if bag.missing:
            note(f"note: {bag.missing}; its intact part is played")
        for name in bag.left_out:
            note(f"note: {name} is left out: metadata.yaml does not list it")
        facts = play(bag, options, rate, stop, ros_arguments)
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
