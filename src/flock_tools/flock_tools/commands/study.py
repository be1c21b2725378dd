# SPDX-License-Identifier: Apache-2.0
"""The effect of late, rare and lost messages on a formation: `flock study`."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence

from flock_sim.console.arguments import Parser, run_tool
from flock_tools.figures.files import FigureFiles, add_output_option, write_figures

DESCRIPTION = """\
Fly flocks whose messages are late, rare or lost, without ROS, and draw the figure of
docs/coupling.md, as PNG and SVG, with its data as CSV. This takes some minutes."""

EXAMPLES = """\
  ./flock study                       writes docs/figures/coupling.png and its data
  ./flock study --output figures"""


def study() -> Iterator[FigureFiles]:
    """Fly the flocks of the study and draw its figure."""
    from flock_sim.configuration.flock_configuration import FlockConfiguration
    from flock_sim.console.progress import counter
    from flock_sim.physics.flock import Flock
    from flock_sim.theory.delayed.linearisation import HOLD, LINEAR
    from flock_sim.theory.delayed.stability import crossings
    from flock_tools.experiments.coupling_study import FAULTS, delayed_flights, limits_over_links
    from flock_tools.figures.coupling import delayed_table, draw_study, held_table

    flights = sum(len(values) for keys in FAULTS.values() for values in keys.values())
    with counter("flying", "flights", flights + 2) as show:
        delayed = []
        for model in (HOLD, LINEAR):
            delayed += delayed_flights(model)
            show(1)
        limits = list(limits_over_links(show))
    (critical,) = crossings(Flock.of(FlockConfiguration(birds=3)), [30.0, 60.0], LINEAR)
    tables = {"_abc": delayed_table(delayed), "_def": held_table(limits)}
    yield FigureFiles("coupling", draw_study(delayed, limits, critical.lag), tables)


def tool(arguments: Sequence[str]) -> int:
    """Write the figure and print its path."""
    parser = Parser("study", DESCRIPTION, EXAMPLES)
    add_output_option(parser)
    write_figures(study(), parser.parse_args(arguments).output)
    return 0


def main() -> int:
    """Run the `study` executable."""
    return run_tool(tool)


if __name__ == "__main__":
    sys.exit(main())
