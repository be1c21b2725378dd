# SPDX-License-Identifier: Apache-2.0
"""The paper's figures 2 to 5, from computed data: `flock figures`."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence

from flock_sim.console.arguments import Parser, run_tool
from flock_tools.figures.files import FigureFiles, add_output_option, write_figures

LOW, HIGH = 0.5, 1.5
"""Range of span ratios in which the limits of figure 4 are searched."""

DESCRIPTION = """\
Compute and draw the paper's figures: 2, the contributions of near and far neighbours; 3, the steady
states of equal birds; 4, the span ratios of one bird that keep the formation; 5, steady states with
one bird of another span. Each figure is written as PNG and SVG, and its data as CSV."""

EXAMPLES = """\
  ./flock figures                     writes docs/figures/figure_2.png and all the others
  ./flock figures --output figures"""


def paper_figures() -> Iterator[FigureFiles]:
    """Compute and draw the figures, one after another."""
    from flock_sim.configuration.flock_configuration import FlockConfiguration
    from flock_sim.theory.span_limits import exact_limits, modified_birds
    from flock_tools.figures.limits import draw_limits, limits_table
    from flock_tools.figures.paper.contributions import contributions, draw_contributions
    from flock_tools.figures.paper.modified_bird import (
        draw_modified,
        modified_flocks,
        modified_table,
    )
    from flock_tools.figures.paper.steady_states import draw_steady, steady_flocks

    contributed = contributions()
    yield FigureFiles("figure_2", draw_contributions(contributed), {"": contributed.table()})

    equal = steady_flocks()
    tables = {"a": equal.configurations(), "bc": equal.means()}
    yield FigureFiles("figure_3", draw_steady(equal), tables)

    flock = FlockConfiguration(birds=13)
    limits = exact_limits(flock, modified_birds(flock), LOW, HIGH)
    picture = draw_limits(limits, flock, LOW, HIGH)
    yield FigureFiles("figure_4", picture, {"": limits_table(limits, flock)})

    modified = modified_flocks()
    yield FigureFiles("figure_5", draw_modified(modified), {"": modified_table(modified)})


def tool(arguments: Sequence[str]) -> int:
    """Write the figures and print their paths."""
    parser = Parser("figures", DESCRIPTION, EXAMPLES)
    add_output_option(parser)
    write_figures(paper_figures(), parser.parse_args(arguments).output)
    return 0


def main() -> int:
    """Run the `figures` executable."""
    return run_tool(tool)


if __name__ == "__main__":
    sys.exit(main())
