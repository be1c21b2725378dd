# SPDX-License-Identifier: Apache-2.0
"""The option that says which recorded moment of a run is looked at."""

from __future__ import annotations

import argparse
import math

from flock_sim.errors import FlockError


def add_moment_option(parser: argparse.ArgumentParser) -> None:
    """Add --at."""
    parser.add_argument(
        "--at", metavar="T", help="a recorded time, in b/U_min (the last recorded one)"
    )


def moment(options: argparse.Namespace) -> float | None:
    """Return the time in b / U_min, None for the last. Raises FlockError on what is no time."""
    if options.at is None:
        return None
    try:
        time = float(options.at)
    except ValueError:
        time = math.nan
    if not 0.0 <= time < math.inf:
        raise FlockError(f"--at {options.at}: must be a finite time, 0 or more")
    return time
