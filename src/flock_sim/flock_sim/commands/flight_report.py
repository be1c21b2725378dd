# SPDX-License-Identifier: Apache-2.0
"""Common part of `fly` and `reference`: the output of a flight, and the report at its end."""

from __future__ import annotations

import argparse
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from flock_sim.console.arguments import note, print_json, print_text
from flock_sim.recording.output_directory import Output, own_new_output, own_output

if TYPE_CHECKING:
    from flock_sim.configuration.flock_configuration import FlockConfiguration
    from flock_sim.recording.own_parts import OwnPart


def add_output_options(parser: argparse.ArgumentParser) -> None:
    """Add the options for the output of a flight and for the report at its end."""
    output = parser.add_argument_group("result")
    output.add_argument(
        "--output", metavar="DIR", type=Path, help="directory of the bag (runs/TOOL-DATE-TIME)"
    )
    output.add_argument("--force", action="store_true", help="replace the bag in --output")
    output.add_argument("--json", action="store_true", help="print the metrics as JSON on stdout")


def claim_output(output: Path | None, force: bool, tool: str) -> Output:
    """Own `output`; if it is None, a new directory for a flight of `tool`.

    Raises FlockError as `own_output`.
    """
    if output is not None:
        return own_output(output, force)
    return own_new_output(Path("runs") / f"{tool}-{datetime.now():%Y%m%d-%H%M%S}")


def report(flight: dict[str, Any], configuration: FlockConfiguration, as_json: bool) -> None:
    """Print the metrics of the bag that was written, and those of the flight itself.

    `flight` holds steps_per_second, wall_seconds, output (None: not recorded) and last_step, which
    is less than that of the configuration if the flight was stopped.
    """
    last = flight["last_step"]
    metrics = means = verdicts = fresh = digest = None
    own: list[OwnPart] = []
    if flight["output"] is not None:
        # Imported at the end of a flight, so that they do not delay its start.
        from flock_sim.analysis.summary import summary
        from flock_sim.recording.message_age import freshness
        from flock_sim.recording.own_parts import lacking
        from flock_sim.recording.run import Run

        with Run(flight["output"]) as run:
            metrics, verdicts = run.metrics(), run.verdicts()
            means = run.time_means(metrics.t_final)
            fresh, own, digest = freshness(run), run.own_parts, run.state_digest
    if last < configuration.steps:
        on = "" if flight["output"] is None else f"; fly --resume {flight['output']} continues it"
        note(f"note: the flight was ended at step {last} of {configuration.steps}{on}")
    rest = last % configuration.record_every
    if metrics is not None and rest:
        note(
            f"note: the last {rest} steps were flown but not recorded: the last recorded step is "
            f"{metrics.steps}; choose a --record-every that divides {last}"
        )
    if own:
        note(f"note: {lacking(own)}")
    if as_json:
        measured = (metrics, means, verdicts, fresh)
        said = [known.as_json() for known in measured if known is not None]
        said.append({"own_parts": [str(part) for part in own], "state_digest": digest})
        print_json({key: value for part in (*said, flight) for key, value in part.items()})
        return
    if metrics is not None and means is not None and verdicts is not None:
        print_text(summary(metrics, means, verdicts))
    if fresh is not None:
        print_text("\n".join(fresh.told()))
    if flight["wall_seconds"]:
        print_text(
            f"flown: {last} steps, {flight['steps_per_second']:.0f} steps/s, "
            f"{flight['wall_seconds']:.1f} s in all"
        )
    if flight.get("rewinds"):
        print_text(
            f"recovered: {flight['restarts']} processes restarted, {flight['rewinds']} rewinds "
            f"to the last step on disk, {flight['steps_flown_again']} steps flown again"
        )
    if metrics is not None:
        print_text(f"bag:   {flight['output']}")
