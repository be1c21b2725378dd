# SPDX-License-Identifier: Apache-2.0
"""A flock in space, for RViz and Foxglove, as a bag or as a picture: `flock view`."""

from __future__ import annotations

import os
import re
import sys
from argparse import Namespace
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

from flock_sim.configuration.options import flock_configuration
from flock_sim.console.arguments import (
    LONGEST,
    Parser,
    note,
    positive_number,
    run_tool,
    whole_number,
)
from flock_sim.console.signals import Stop
from flock_sim.console.stdout import results_only_on_stdout
from flock_sim.errors import FlockError, RunFailed
from flock_sim.ros.discovery import DOMAIN, NETWORK_HELP, prepare_discovery
from flock_sim.ros.ros_arguments import split
from flock_tools.commands.options import add_moment_option, moment
from flock_tools.figures.output import check_picture, write_picture

if TYPE_CHECKING:
    from flock_sim.configuration.flock_configuration import FlockConfiguration
    from flock_tools.scene.viewer import Viewer

DESCRIPTION = """\
Show a flock that is flown or played, in 3D and SI units: birds of true span, coloured by the drag
that they save; their wakes, coloured by the upward air speed; their trails in the formation; and
the upward air speed on a plane behind the flock. RViz or any Foxglove bridge can show the topics

  /flock/view/markers      visualization_msgs/MarkerArray, in the frame flock
  /flock/view/upwash       sensor_msgs/Image, 32FC1: upwash behind the flock, in m/s
  /flock/view/upwash_color sensor_msgs/Image, rgb8: the same as colours, with a legend
  /flock/view/transform    geometry_msgs/TransformStamped from the frame world to the frame flock,
                           which moves with the leader; also on /tf if tf2_msgs is installed

and with --odometry also

  /flock/bird_NN/odometry  nav_msgs/Odometry of each bird, from the frame world to the frame bird_NN

--foxglove serves them to Foxglove without a bridge. --output writes those of a recorded flight into
a rosbag2 bag (MCAP), for viewers that open files: Foxglove, Lichtblick, Rerun, or RViz through
`ros2 bag play`. Details are in docs/view.md.
Exit status: 0 bag or picture written; 1 the disk is full; 2 bad input, or no flock found within
--timeout; 130 Ctrl-C."""

EXAMPLES = """\
  ./flock view
  ./flock view --foxglove                    then open ws://localhost:8765 in Foxglove
  ./flock view --member 2 --rate 5
  ./flock view --odometry
  ./flock view --output runs/scene runs/demo
  ./flock view --picture scene.png runs/demo"""

FOXGLOVE_PORT = "8765"
HOST = "127.0.0.1"
LAST_PORT = 65535

ORIGIN = re.compile(r"([a-z][a-z0-9+.-]*://[^/\s]*|null)/?", re.IGNORECASE)
"""Origins of web pages in the form that a browser sends; null for an undisclosed origin."""

MOST_REFUSALS = 10
"""Largest number of refused web pages that are reported to the user."""

RATE = "10"
"""Default of --rate for a flock that is flown or played, in Hz."""

FASTEST = 60.0
"""Largest --rate, in Hz: more than the eye sees, and more than viewers draw."""


def tool(arguments: Sequence[str]) -> int:
    """Publish a flock until Ctrl-C, or draw it once."""
    parser = Parser("view", DESCRIPTION, EXAMPLES)
    parser.add_argument(
        "--member", metavar="M", default="1", help="number of the member to show (1)"
    )
    parser.add_argument(
        "--rate",
        metavar="HZ",
        help=f"largest number of updates per second ({RATE}); with --output, number of pictures "
        "per second of simulated time (as many as give about 300)",
    )
    parser.add_argument(
        "--config",
        metavar="FILE",
        type=Path,
        help="configuration of the flock if no clock sends it",
    )
    parser.add_argument(
        "--timeout", metavar="S", default="10", help="how long to wait for a flock, in s (10)"
    )
    parser.add_argument("--network", action="store_true", help=NETWORK_HELP)
    parser.add_argument(
        "--odometry",
        action="store_true",
        help="publish, or write with --output, also nav_msgs/Odometry of each bird, and its frame "
        "bird_NN on /tf",
    )
    server = parser.add_argument_group("Foxglove")
    server.add_argument(
        "--foxglove",
        metavar="PORT",
        nargs="?",
        const=FOXGLOVE_PORT,
        help=f"serve a Foxglove WebSocket on this port ({FOXGLOVE_PORT}; 0: any free port)",
    )
    server.add_argument(
        "--host", metavar="HOST", help=f"address to serve on ({HOST}: only for this machine)"
    )
    server.add_argument(
        "--foxglove-origin",
        metavar="URL",
        action="append",
        help="accept web pages from this origin, such as https://app.foxglove.dev; may be "
        "repeated. Programs, and pages that this machine serves, are always accepted",
    )
    recorded = parser.add_argument_group("recorded flight")
    recorded.add_argument(
        "run",
        metavar="RUN",
        nargs="?",
        type=Path,
        help="directory of a bag, for --output or --picture",
    )
    recorded.add_argument(
        "--output", metavar="DIR", type=Path, help="write the scene of RUN to a new bag, and end"
    )
    recorded.add_argument("--force", action="store_true", help="replace the bag in --output")
    recorded.add_argument(
        "--picture", metavar="FILE", type=Path, help="draw RUN to this file, and end"
    )
    add_moment_option(parser)
    arguments, ros_arguments = split(arguments)
    options = parser.parse_args(arguments)
    options.ros_arguments = ros_arguments
    if options.output is not None:
        return _record(options)
    if options.force:
        raise FlockError("--force: is for --output; give both, or leave it out")
    if options.picture is None:
        return _show(options)
    return _draw(options)


def _record(options: Namespace) -> int:
    """Write the scene of a recorded flight to a bag, and print its path."""
    output, force = options.output, options.force
    if options.run is None:
        raise FlockError(f"--output {output}: needs a RUN to show; name the directory of a bag")
    for name, value in (("--picture", options.picture), ("--foxglove", options.foxglove)):
        if value is not None:
            raise FlockError(f"--output and {name} exclude each other: leave one out")
    if options.at is not None:
        raise FlockError(f"--at {options.at}: is for --picture; --output shows the whole flight")
    rate = None if options.rate is None else _rate(options.rate)

    from flock_sim.console.progress import counter
    from flock_sim.recording.output_directory import own_output
    from flock_sim.recording.run import Run
    from flock_tools.scene.scene_bag import Pictures, write_scene

    with Run(options.run) as run:
        if run.missing:
            note(f"note: {run.missing}; its intact part is shown")
        member = whole_number("--member", options.member, 1, run.configuration.members)
        pictures = Pictures.of(run.configuration, run.at().step, rate)
        with (
            own_output(output, force) as owned,
            counter("drawing", "pictures", len(pictures)) as show,
        ):
            size = write_scene(run, member - 1, pictures, owned, show, options.odometry)
    note(
        f"{len(pictures)} pictures of member {member}, {pictures.rate:.3g} per second of simulated "
        f"time, {size / 1e6:.1f} MB; --rate HZ changes their number"
    )
    print(output)
    return 0


def _draw(options: Namespace) -> int:
    """Write a picture, and print its path."""
    if options.run is None:
        raise FlockError(
            f"--picture {options.picture}: needs a RUN to draw; name the directory of a bag"
        )
    if options.foxglove is not None:
        raise FlockError("--picture and --foxglove exclude each other: leave one out")
    if options.odometry:
        raise FlockError("--picture and --odometry exclude each other: leave one out")
    time_shown = moment(options)
    check_picture(options.picture, "--picture")

    from flock_sim.recording.run import Run
    from flock_tools.scene.picture import FINE_ROWS, draw_scene, scene_of

    with Run(options.run) as run:
        if run.missing:
            note(f"note: {run.missing}; its intact part is drawn")
        member = whole_number("--member", options.member, 1, run.configuration.members)
        figure = draw_scene(scene_of(run, time_shown, member - 1, FINE_ROWS))
    write_picture(figure, options.picture, "--picture")
    print(options.picture)
    return 0


def _show(options: Namespace) -> int:
    """Publish until Ctrl-C."""
    if options.run is not None:
        raise FlockError(
            f"RUN {options.run}: is for --output and --picture; to see a recorded flight live, "
            "./flock play RUN"
        )
    if options.at is not None:
        raise FlockError(f"--at {options.at}: is for --picture; give both")
    member = whole_number("--member", options.member, 1)
    rate = _rate(options.rate or RATE)
    timeout = positive_number("--timeout", options.timeout)
    if options.host is not None and options.foxglove is None:
        raise FlockError(f"--host {options.host}: is for --foxglove; give both")
    origins = [origin(text) for text in options.foxglove_origin or ()]
    if origins and options.foxglove is None:
        raise FlockError(f"--foxglove-origin {origins[0]}: is for --foxglove; give both")
    port = None
    if options.foxglove is not None:
        port = whole_number("--foxglove", options.foxglove, 0, LAST_PORT)

    assumed = flock_configuration(options)
    prepare_discovery(options.network)
    stop = Stop(heed_interrupt=True)
    address = (options.host or HOST, port, origins)
    _publish(member, rate, timeout, assumed, address, options.odometry, stop, options.ros_arguments)
    return stop.exit_status


def _rate(text: str) -> float:
    """Return the number of pictures per second. Raises FlockError if it is out of range."""
    rate = positive_number("--rate", text)
    if rate > FASTEST:
        raise FlockError(f"--rate {text}: must be {FASTEST:g} or less")
    return rate


def origin(text: str) -> str:
    """Return `text` as the origin that a browser sends. Raises FlockError if it is none."""
    match = ORIGIN.fullmatch(text)
    if match is None:
        raise FlockError(
            f"--foxglove-origin {text}: must be of the form https://HOST or https://HOST:PORT, as "
            "the browser names it"
        )
    return match[1].lower()


def _publish(
    member: int,
    rate: float,
    timeout: float,
    assumed: FlockConfiguration,
    address: tuple[str, int | None, Sequence[str]],
    odometry: bool,
    stop: Stop,
    ros_arguments: Sequence[str],
) -> None:
    """Publish the received flock until `stop`. Raises FlockError if no flock is received."""
    # Imported here: a picture, or a report of bad input, does not need them.
    from flock_tools.live.listener import first_sample, serve, watching
    from flock_tools.scene.frame import MARKERS_TOPIC
    from flock_tools.scene.viewer import FOXGLOVE_TYPES, Viewer

    host, port, origins = address
    with results_only_on_stdout(), ExitStack() as opened:
        server = None
        if port is not None:
            try:
                from flock_tools.scene.foxglove_server import FoxgloveServer
            except ImportError:
                raise FlockError(
                    f"--foxglove {port}: needs `pip install --upgrade websockets`"
                ) from None
            server = opened.enter_context(
                FoxgloveServer(host, port, FOXGLOVE_TYPES, origins, _refusals())
            )
        viewer, executor = opened.enter_context(
            watching(
                lambda context: Viewer(context, member, assumed, server, odometry), ros_arguments
            )
        )
        try:
            sample = first_sample(viewer, executor, member, timeout, stop)
        except RunFailed as error:
            raise FlockError(str(error)) from error
        if sample is None:
            return
        if not viewer.shows:
            raise FlockError(
                f"the states of {sample.birds} birds are heard, but not their wings, within "
                f"{timeout:g} s: fly, or play all topics, or give a longer --timeout"
            )
        told = _tell_assumed(viewer)
        note(
            f"showing {sample.birds} birds, member {sample.member} of {sample.members}, on "
            f"{MARKERS_TOPIC}, ROS domain {os.environ.get(DOMAIN) or 0}; Ctrl-C ends it"
        )
        if server:
            note(f"Foxglove: open the connection {server.address}")
        while not stop:
            viewer.publish()
            told = told or _tell_assumed(viewer)
            serve(executor, period(rate), stop)


def _tell_assumed(viewer: Viewer) -> bool:
    """Tell the user if the configuration of the shown flock is assumed; return whether it is."""
    if viewer.tells_flown:
        return False
    why = "no clock sends the configuration"
    if unreadable := viewer.view.unreadable:
        why = f"the configuration that the clock sends can't be read ({unreadable})"
    note(f"note: {why}; SI units and drag saved follow --config")
    return True


def _refusals() -> Callable[[str], None]:
    """Return a function that reports each refused web page to the user once."""
    told: set[str] = set()

    def refused(page: str) -> None:
        if page in told or len(told) == MOST_REFUSALS:
            return
        told.add(page)
        note(
            f"note: Foxglove: refused a web page from {page}; if you trust it: "
            f"--foxglove-origin {page}"
        )

    return refused


def period(rate: float) -> float:
    """Return the time between scenes, in s, at most LONGEST."""
    return min(1.0 / rate, LONGEST)


def main() -> int:
    """Run the `view` executable."""
    return run_tool(tool)


if __name__ == "__main__":
    sys.exit(main())
