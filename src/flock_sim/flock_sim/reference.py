# SPDX-License-Identifier: Apache-2.0
"""The same flight without ROS: the whole flock in one loop, written to the same kind of bag."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from pathlib import Path

from flock_sim.bag.output import claim_output
from flock_sim.command_line import Parser, add_flock_options, flock_configuration, note, run_tool
from flock_sim.core.configuration import FlockConfiguration
from flock_sim.core.ledger import Row
from flock_sim.core.messages import State, Time, Wing
from flock_sim.core.monolith import Monolith, Recorded
from flock_sim.progress import progress_bar
from flock_sim.recording import recording
from flock_sim.report import add_output_options, output_directory, report
from flock_sim.warm import warm

EXAMPLES = """\
  ./flock reference --birds 7 --t-max 1e5
  ./flock reference --output runs/reference && ./flock compare runs/demo runs/reference"""


def tool(arguments: Sequence[str]) -> int:
    """Integrate a flock as one system, record it, and say what came of it."""
    parser = Parser("reference", "Fly a flock in one loop, without ROS, bit for bit.", EXAMPLES)
    add_flock_options(parser)
    add_output_options(parser)
    options = parser.parse_args(arguments)
    configuration = flock_configuration(options)
    output = output_directory(options, "reference")
    claim_output(output, options.force)
    note(f"recording to {output}")
    begun = time.monotonic()
    seconds = _integrate(configuration, output)
    flight = {
        "steps_per_second": configuration.steps / seconds,
        "wall_seconds": time.monotonic() - begun,
        "output": str(output),
    }
    report(flight, configuration, options.json)
    return 0


def _integrate(configuration: FlockConfiguration, output: Path) -> float:
    """Integrate and record; return the seconds that went into the integration itself."""
    warm()  # loading compiled code is no part of the rate
    seconds = 0.0
    with (
        recording(output, configuration, grants=False) as run,
        progress_bar("integrating", configuration) as show,
    ):
        flight = Monolith(configuration).fly()
        while True:
            begun = time.perf_counter()
            recorded = next(flight, None)
            seconds += time.perf_counter() - begun
            if recorded is None:
                return seconds
            run.write_row(row(configuration, recorded))
            show(recorded.step)


def row(configuration: FlockConfiguration, recorded: Recorded) -> Row:
    """Return a recorded step as the messages that a flock of nodes would have sent."""
    birds = range(configuration.birds)
    ratio = configuration.span_ratio
    wings = [Wing(0, i + 1, ratio[i]).encode() for i in birds] if recorded.step == 0 else []
    time_message = Time.at(configuration.stamp(recorded.step)).encode()
    states = [
        State.at(
            configuration,
            recorded.step,
            recorded.position[i],
            recorded.speed[i],
            recorded.circulation[i],
            recorded.interaction_drag[i],
        ).encode()
        for i in birds
    ]
    return Row(recorded.step, wings, [], time_message, states)


def main() -> int:
    """Run the `reference` executable."""
    return run_tool(tool)


if __name__ == "__main__":
    sys.exit(main())
