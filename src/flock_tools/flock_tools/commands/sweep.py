# SPDX-License-Identifier: Apache-2.0
"""Flights of a flock over a grid of parameters: `flock sweep FILE`."""

from __future__ import annotations

import argparse
import shlex
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from flock_sim.console.arguments import (
    TIMEOUT,
    Parser,
    note,
    positive_number,
    print_json,
    print_text,
    run_tool,
    whole_number,
)
from flock_sim.errors import FlockError
from flock_tools.commands.options import add_scheduler_option
from flock_tools.experiments.sweep.size import AT_ONCE
from flock_tools.figures.output import write_picture

if TYPE_CHECKING:
    import xarray as xr

    from flock_tools.experiments.sweep.dataset import Values
    from flock_tools.experiments.sweep.directory import SweepDirectory
    from flock_tools.experiments.sweep.specification import Flight, Sweep

PROCESSES = "1"

DESCRIPTION = """\
Fly a flock for all combinations of values along some axes, many of them at once as members of one
flight over ROS 2. The results of all members are written to one NetCDF file, sweep.nc, with the
axes as coordinates, and drawn in one picture, sweep.png, both in --output beside the bags of the
flights.
With --reference, the members fly without ROS, on all cores or on a Dask cluster. This is faster,
and the results are the same to the bit, but there are no bags.
FILE is YAML: `flock:` holds keys of a configuration file that all members have in common, and
`axes:` the values that differ, as a list or as {from: , to: , count: }:
  span_ratio[I]                  span ratio of bird I (also lambda_I)
  position[I], speed[I]          change of the start of bird I, in b and U_min
  link.KEY, link[I:J].KEY        of all links or one: model, delay, drop, interval, noise, seed ...
  forcing.LAW.KEY                of the forcing by this law; forcing[I].LAW.KEY: of that of bird I
  coupling, dt, cruise_speed ... keys of a configuration; each value has flights of its own
If a sweep is interrupted, by Ctrl-C or kill -9 at any time, the same command continues it: complete
flights are not flown again, and an incomplete flight is resumed. With --reference, the members of
the last seconds before a kill are flown again. If --output holds another sweep, the command is
refused.
Exit status: 0 all flights are complete, whatever their results; 1 a flight failed; 2 bad input."""

EXAMPLES = """\
  ./flock sweep delays.yaml                       writes runs/delays/sweep.nc, sweep.png
  ./flock sweep delays.yaml --output runs/mine --processes 2 --json
  ./flock sweep delays.yaml --reference           without ROS, on all cores
with delays.yaml:
  flock:
    birds: 7
    links: ["linear:interval=5"]
  axes:
    span_ratio[2]: {from: 0.95, to: 1.05, count: 41}
    link.delay: [0, 5, 10, 20]"""


def tool(arguments: Sequence[str]) -> int:
    """Fly a sweep, or the rest of it, and print a summary."""
    options = _parser().parse_args(arguments)
    begun = time.monotonic()

    from flock_tools.experiments.sweep.directory import SweepDirectory
    from flock_tools.experiments.sweep.specification import read

    _check_way(options)
    sweep = read(options.file)
    at_once = whole_number("--members-at-once", options.members_at_once, 1)
    how = [] if options.reference else _how_flown(options, sweep)
    flights = sweep.flights(at_once)
    output = options.output if options.output is not None else Path("runs") / options.file.stem
    directory = SweepDirectory(output)
    with directory.held(sweep.plan(at_once, options.reference), options.force):
        note(f"{_told(sweep)}, {len(flights)} flight{'s' * (len(flights) > 1)} into {output}")
        values, flown = _flown(options, sweep, flights, directory, how)
        if not flown:
            note("all flights are complete: there is nothing left to fly")
        # Imported after the flights: matplotlib takes 0.5 s.
        from flock_tools.experiments.sweep.dataset import counted, dataset, netcdf
        from flock_tools.figures.sweep import draw_sweep

        found = dataset(sweep, values, shlex.join(["./flock", "sweep", *arguments]))
        directory.write(directory.data, netcdf(found))
        write_picture(draw_sweep(found, sweep), directory.picture)
    facts = {
        "members": sweep.size,
        "axes": {axis.name: len(axis.values) for axis in sweep.axes},
        "verdicts": counted(found),
        "holds": int(found.holds.sum()),
        "diverged": int(found.diverged.sum()),
        "flights": len(flights),
        "flights_flown": flown,
        "wall_seconds": time.monotonic() - begun,
        "reference": options.reference,
        "output": str(output),
        "dataset": str(directory.data),
        "picture": str(directory.picture),
    }
    if options.json:
        print_json(facts)
    else:
        print_text(described(sweep, found, facts))
    return 0


def _check_way(options: argparse.Namespace) -> None:
    """Raise FlockError on an option that does not apply to the way of flying."""
    ways = {False: ("scheduler",), True: ("processes", "timeout")}
    for name in ways[options.reference]:
        if getattr(options, name) is not None:
            way, remedy = (
                ("flights over ROS 2", "leave it out with --reference")
                if options.reference
                else ("--reference", "add --reference, or leave it out")
            )
            raise FlockError(f"--{name} is for {way}: {remedy}")


def _how_flown(options: argparse.Namespace, sweep: Sweep) -> list[str]:
    """Return the options of `fly` for all flights. Raises FlockError if ROS 2 can't be used."""
    from flock_sim.launcher.partition import process_count
    from flock_sim.ros.discovery import prepare_discovery

    processes = PROCESSES if options.processes is None else options.processes
    timeout = TIMEOUT if options.timeout is None else options.timeout
    count = process_count("--processes", processes, sweep.flock.birds, sweep.flock.coupling)
    seconds = positive_number("--timeout", timeout)
    try:
        prepare_discovery()  # fails here, before files are replaced, rather than in each flight
    except ImportError as error:
        raise FlockError(f"flights over ROS 2 need ROS 2 ({error}): add --reference") from None
    return ["--processes", str(count), "--timeout", str(seconds)]


def _flown(
    options: argparse.Namespace,
    sweep: Sweep,
    flights: Sequence[Flight],
    directory: SweepDirectory,
    how: Sequence[str],
) -> tuple[Values, int]:
    """Fly the rest of the sweep; return all results, and the number of flights flown."""
    if options.reference:
        from flock_tools.experiments.sweep.by_reference import fly_parts

        parts = sweep.parts(int(options.members_at_once))
        values, rest = fly_parts(sweep, parts, directory, options.scheduler)
        return values, len({part.flight for part in rest})

    from flock_tools.experiments.sweep.runner import fly_all

    flown = fly_all(flights, directory, how)
    # Imported after the flights: xarray takes 0.5 s.
    from flock_tools.experiments.sweep.dataset import recorded

    return recorded(sweep, flights, [directory.bag(flight) for flight in flights]), flown


def _parser() -> Parser:
    parser = Parser("sweep", DESCRIPTION, EXAMPLES)
    parser.add_argument("file", metavar="FILE", type=Path, help="the sweep in YAML, as above")
    result = parser.add_argument_group("result")
    result.add_argument(
        "--output", metavar="DIR", type=Path, help="directory of the sweep (runs/NAME-OF-FILE)"
    )
    result.add_argument("--force", action="store_true", help="replace the sweep in --output")
    result.add_argument("--json", action="store_true", help="print a summary as JSON on stdout")
    how = parser.add_argument_group("how it is flown", "these options do not change the results")
    how.add_argument(
        "--members-at-once",
        metavar="M",
        default=str(AT_ONCE),
        help=f"members of one flight, at most ({AT_ONCE})",
    )
    how.add_argument(
        "--processes",
        metavar="P",
        help=f"over ROS 2: number of processes that the birds share ({PROCESSES})",
    )
    how.add_argument(
        "--timeout",
        metavar="S",
        help=f"over ROS 2: time without progress after which a flight fails, in s ({TIMEOUT})",
    )
    how.add_argument("--reference", action="store_true", help="fly without ROS, on all cores")
    add_scheduler_option(how, "flies, with --reference")
    return parser


def described(sweep: Sweep, found: xr.Dataset, facts: dict[str, Any]) -> str:
    """Return the result as text."""
    from flock_sim.analysis.metrics import STABLE_BELOW
    from flock_sim.analysis.verdict import shortest_time
    from flock_sim.physics.scaling import Scales

    verdicts = ", ".join(f"{count} {word}" for word, count in facts["verdicts"].items() if count)
    speeds = found.mean_speed.where(found.diverged == 0)
    lines = [
        _told(sweep),
        f"  verdicts             {verdicts}",
        f"  sigma_U < {STABLE_BELOW:g}     {facts['holds']} of {facts['members']}",
        f"  diverged             {facts['diverged']}",
    ]
    least = shortest_time(Scales.of(sweep.flock))
    if facts["verdicts"]["settling"] and sweep.flock.t_max < least:
        lines.insert(
            2, f"                       t_max is too short: a verdict needs {least:.0f} b/U_min"
        )
    if facts["diverged"] < facts["members"]:
        lines.append(
            f"  mean speed           {float(speeds.min()):.6f} to {float(speeds.max()):.6f} U_min"
        )
    return "\n".join(
        [
            *lines,
            f"flown: {facts['flights_flown']} of {facts['flights']} flights, "
            f"{facts['wall_seconds']:.1f} s in all",
            f"data:    {facts['dataset']}",
            f"picture: {facts['picture']}",
        ]
    )


def _told(sweep: Sweep) -> str:
    axes = " x ".join(f"{axis.name} ({len(axis.values)})" for axis in sweep.axes)
    return f"{sweep.size} member{'s' * (sweep.size > 1)}: {axes}"


def main() -> int:
    """Run the `sweep` executable."""
    return run_tool(tool)


if __name__ == "__main__":
    sys.exit(main())
