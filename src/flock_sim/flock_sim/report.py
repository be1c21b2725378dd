# SPDX-License-Identifier: Apache-2.0
"""What `fly` and `reference` have in common: where a flight goes, and what is said at its end."""

from __future__ import annotations

import argparse
from datetime import datetime
from pathlib import Path
from typing import Any

from flock_sim.command_line import note, print_json
from flock_sim.core.configuration import FlockConfiguration
from flock_sim.freshness import freshness
from flock_sim.run import Run
from flock_sim.summary import summary


def add_output_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that say where a flight is recorded and how its end is told."""
    output = parser.add_argument_group("result")
    output.add_argument(
        "--output", metavar="DIR", type=Path, help="directory of the bag (runs/TOOL-DATE-TIME)"
    )
    output.add_argument("--force", action="store_true", help="replace the bag in --output")
    output.add_argument("--json", action="store_true", help="print the metrics as JSON on stdout")


def output_directory(options: argparse.Namespace, tool: str) -> Path:
    """Return --output, or a new name of its own for a flight of `tool`."""
    if options.output is not None:
        return Path(options.output)
    return Path("runs") / f"{tool}-{datetime.now():%Y%m%d-%H%M%S}"


def report(flight: dict[str, Any], configuration: FlockConfiguration, as_json: bool) -> None:
    """Print the metrics of the bag that was written, and how the flight went.

    `flight` holds steps_per_second, wall_seconds and output (None: not recorded).
    """
    metrics = fresh = None
    if flight["output"] is not None:
        with Run(flight["output"]) as run:
            metrics = run.metrics()
            fresh = freshness(run)
    rest = configuration.steps % configuration.record_every
    if metrics is not None and rest:
        note(
            f"note: the last {rest} steps are flown and not recorded: the last recorded step is "
            f"{metrics.steps}; choose a --record-every that divides {configuration.steps}"
        )
    if as_json:
        said = [known.as_json() for known in (metrics, fresh) if known is not None]
        print_json({key: value for part in (*said, flight) for key, value in part.items()})
        return
    if metrics is not None:
        print(summary(metrics))
    if fresh is not None:
        print("\n".join(fresh.told()))
    if flight["wall_seconds"]:
        print(
            f"flown: {configuration.steps} steps, {flight['steps_per_second']:.0f} steps/s, "
            f"{flight['wall_seconds']:.1f} s in all"
        )
    if flight.get("rewinds"):
        print(
            f"recovered: {flight['restarts']} processes started again, {flight['rewinds']} times "
            f"back to what is on disk, {flight['steps_flown_again']} steps flown again"
        )
    if metrics is not None:
        print(f"bag:   {flight['output']}")
