# SPDX-License-Identifier: Apache-2.0
"""What late, rare and lost messages do to a formation: `flock study`."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence

from flock_sim.command_line import Parser, run_tool
from flock_sim.core.configuration import FlockConfiguration
from flock_sim.core.flock import Flock
from flock_sim.core.lag_stability import crossings
from flock_sim.core.lagged_motion import HOLD, LINEAR
from flock_sim.progress import counter
from flock_tools.figure_files import FigureFiles, add_output_option, write_figures
from flock_tools.study_figure import draw_study
from flock_tools.study_flights import (
    FAULTS,
    held_table,
    lagged_flights,
    lagged_table,
    limits_over_links,
)

DESCRIPTION = """\
Fly geese whose messages are late, rare or lost, by the reference, and draw the figure of
docs/coupling.md: as PNG and SVG, and its data as CSV. It takes some minutes."""

EXAMPLES = """\
  ./flock study                       writes docs/figures/coupling.png and its data
  ./flock study --output figures"""


def study() -> Iterator[FigureFiles]:
    """Fly and draw."""
    flights = sum(len(values) for keys in FAULTS.values() for values in keys.values())
    with counter("flying", "flights", flights + 2) as show:
        lagged = []
        for model in (HOLD, LINEAR):
            lagged += lagged_flights(model)
            show(1)
        limits = list(limits_over_links(show))
    (critical,) = crossings(Flock.of(FlockConfiguration(birds=3)), [30.0, 60.0], LINEAR)
    tables = {"_abc": lagged_table(lagged), "_def": held_table(limits)}
    yield FigureFiles("coupling", draw_study(lagged, limits, critical.lag), tables)


def tool(arguments: Sequence[str]) -> int:
    """Write the figure and say where it is."""
    parser = Parser("study", DESCRIPTION, EXAMPLES)
    add_output_option(parser)
    write_figures(study(), parser.parse_args(arguments).output)
    return 0


def main() -> int:
    """Run the `study` executable."""
    return run_tool(tool)


if __name__ == "__main__":
    sys.exit(main())
