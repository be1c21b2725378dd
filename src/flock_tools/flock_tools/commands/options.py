# SPDX-License-Identifier: Apache-2.0
"""Options that several tools have, and checks of what they are given."""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING

from flock_sim.console.arguments import (
    numbers,
)
from flock_sim.errors import FlockError
from flock_sim.outside.printing import shown

if TYPE_CHECKING:
    from flock_sim.configuration.flock_configuration import FlockConfiguration


def add_moment_option(parser: argparse.ArgumentParser) -> None:
    """Add --at."""
    parser.add_argument("--at", metavar="T", help="a recorded time, in b/U_min (the last one)")


def moment(options: argparse.Namespace) -> float | None:
    """Return the time in b / U_min, None for the last. Raises FlockError on an invalid time."""
    return _time("--at", options.at, 0.0, "a finite time, 0 or more")


def span(options: argparse.Namespace) -> float | None:
    """Return the time of --over in b / U_min, None without it. Raises FlockError if invalid."""
    return _time("--over", options.over, math.ulp(0.0), "a finite time above 0")


def _time(option: str, text: str | None, least: float, range_: str) -> float | None:
    """Return the time in `text`, at least `least`; None for none. `range_` describes the range."""
    if text is None:
        return None
    try:
        time = float(text)
    except ValueError:
        time = math.nan
    if not least <= time < math.inf:
        raise FlockError(f"{option} {shown(text)}: must be {range_}")
    return time


def add_scheduler_option(group: argparse._ArgumentGroup, does: str) -> None:
    """Add --scheduler; `does` is what a cluster does for the tool, such as "computes"."""
    group.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help=f"Dask scheduler whose cluster {does} (the cores of this machine)",
    )


def add_picture_options(parser: argparse.ArgumentParser, told: str) -> None:
    """Add --output, the file of a picture, and --json; `told` is the help of --output."""
    result = parser.add_argument_group("result")
    result.add_argument("--output", metavar="FILE", type=Path, help=f"{told} (png, svg or pdf)")
    result.add_argument("--json", action="store_true", help="print the result as JSON on stdout")


def two_numbers(text: str) -> tuple[float, float]:
    """Return the two numbers in `text`, between a comma; nan if it has not two numbers."""
    ends = numbers(text)
    return (ends[0], ends[1]) if len(ends) == 2 else (math.nan, math.nan)


def check_links_exact(configuration: FlockConfiguration, tool: str) -> None:
    """Raise FlockError unless all links are `exact` and without faults."""
    if not configuration.link_table.plain:
        raise FlockError(
            f"links {' '.join(configuration.links)}: {tool} solves the exact coupling, "
            "which needs `exact` links without faults; leave the links out, or fly with them: "
            "`./flock fly`"
        )


def check_unforced(configuration: FlockConfiguration, tool: str) -> None:
    """Raise FlockError if forces besides thrust and drag act on the flock."""
    if configuration.forcing:
        raise FlockError(
            f"forcing {' '.join(configuration.forcing)}: {tool} solves the flight without forces "
            "besides thrust and drag; leave the forcing out, or fly with it: `./flock fly`"
        )
