# SPDX-License-Identifier: Apache-2.0
"""The same flight without ROS: the whole flock in one loop, written to the same kind of bag."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from flock_sim.commands.flight_report import add_output_options, claim_output, report
from flock_sim.commands.law_option import LAW_WITHOUT_BAG, add_law_option, load_recorded_laws
from flock_sim.configuration.options import (
    FLOCK_OPTIONS,
    add_flock_options,
    flock_configuration,
)
from flock_sim.console.arguments import Parser, note, run_tool
from flock_sim.errors import FlockError

if TYPE_CHECKING:
    from flock_sim.configuration.flock_configuration import FlockConfiguration
    from flock_sim.configuration.perturbation import Perturbation
    from flock_sim.recording.output_directory import Output
    from flock_sim.recording.run import Run

DESCRIPTION = """\
Fly a flock in one loop, without ROS, record it as a rosbag2 bag, and print its metrics. The
recorded states are the same as those of ./flock fly, to the bit.
Lengths are in b (half the standard wing span), speeds in U_min (the speed of least drag of the
standard bird), times in b/U_min (0.042 s for the default bird, a Canada goose).
Exit status: 0 flown; 1 the flight failed; 2 bad input; 130 Ctrl-C."""

EXAMPLES = """\
  ./flock reference --birds 7 --t-max 1e5
  ./flock reference --output runs/reference && ./flock compare runs/demo runs/reference
  ./flock reference --repeat runs/mine --output runs/again"""


def tool(arguments: Sequence[str]) -> int:
    """Integrate a flock as one system, record it, and print its report."""
    parser = Parser("reference", DESCRIPTION, EXAMPLES)
    add_flock_options(parser)
    parser.add_argument(
        "--repeat",
        metavar="RUN",
        type=Path,
        help="repeat the flight RUN: its configuration, and the perturbations in flight",
    )
    add_law_option(parser, "--repeat")
    add_output_options(parser)
    options = parser.parse_args(arguments)
    if options.law and not options.repeat:
        raise FlockError(LAW_WITHOUT_BAG)
    configuration, live = (
        _repeated(options) if options.repeat else (flock_configuration(options), [])
    )

    with claim_output(options.output, options.force, "reference") as output:
        note(f"recording to {output.path}")
        begun = time.monotonic()
        seconds = _integrate(configuration, live, output)
        flight = {
            "steps_per_second": configuration.steps / seconds,
            "wall_seconds": time.monotonic() - begun,
            "output": str(output.path),
            "last_step": configuration.steps,
        }
        output.check()
        report(flight, configuration, options.json)
    return 0


def _repeated(options: argparse.Namespace) -> tuple[FlockConfiguration, list[Perturbation]]:
    """Return the configuration of the run to repeat, and its perturbations in flight."""
    for key, option in {"config": "--config", **FLOCK_OPTIONS}.items():
        if getattr(options, key) is not None:
            raise FlockError(
                f"{option} and --repeat exclude each other: the configuration is that of "
                f"{options.repeat}; leave one out"
            )

    from flock_sim.recording.run import Run

    with Run(options.repeat) as run:
        if run.missing:
            note(f"note: {run.missing}; it is repeated to its planned end")
        load_recorded_laws(run.own_parts, run.configuration, options.law, f"--repeat {run.path}")
        _check_own(run)
        if run.real_time_factor:
            note(
                f"note: {options.repeat} is a free flight, which can't be repeated; this flight is "
                "in lockstep"
            )
        return run.configuration, run.perturbations()


def _check_own(run: Run) -> None:
    """Raise FlockError if the run has birds that only another program can fly."""
    from flock_sim.recording.own_parts import BIRD, LINK_MODEL, names

    if birds := names(run.own_parts, BIRD):
        raise FlockError(
            f"--repeat {run.path}: it was flown by birds of {birds}, which are not in Flock, and "
            "the bag contains only the name; fly them again by flock_tools.fly(bird=...)"
        )
    if models := names(run.own_parts, LINK_MODEL):
        note(
            f"note: the link model {models} of {run.path} is not in Flock; this flight uses the "
            "one that this process has"
        )


def _integrate(
    configuration: FlockConfiguration, live: Sequence[Perturbation], output: Output
) -> float:
    """Integrate and record; return the time of the integration alone, in s."""
    from flock_sim.console.progress import progress_bar
    from flock_sim.launcher.precompile import warm_reference
    from flock_sim.launcher.reference_flight import record_reference

    # The rate must not include the load of compiled code.
    warm_reference(() if configuration.link_table.plain else ("hold",))
    with progress_bar("integrating", configuration) as show:
        return record_reference(
            output.path, configuration, live, replace=output.replaces, on_step=show
        )


def main() -> int:
    """Run the `reference` executable."""
    return run_tool(tool)


if __name__ == "__main__":
    sys.exit(main())
