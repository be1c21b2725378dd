# SPDX-License-Identifier: Apache-2.0
"""The paper's figures 2 to 5, from computed data: `flock figures`."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.figure import Figure
from matplotlib.transforms import Bbox

from flock_sim.command_line import Parser, run_tool
from flock_sim.core.configuration import FlockConfiguration
from flock_sim.core.limits import exact_limits, modified_birds
from flock_sim.errors import FlockError
from flock_tools.figure_contributions import contributions, draw_contributions
from flock_tools.figure_limits import draw_limits, limits_table
from flock_tools.figure_modified import draw_modified, modified_flocks, modified_table
from flock_tools.figure_steady import draw_steady, steady_flocks
from flock_tools.table import Table

OUTPUT = Path("docs/figures")

LOW, HIGH = 0.5, 1.5
"""Span ratios among which the limits of figure 4 are searched."""

RESOLUTION = 300
"""Of PNG files, in dots per inch."""

PLACES = 5
"""Decimal places of positions, relative to the figure."""

NAMELESS: dict[str, dict[str, Any]] = {
    "png": {"Software": None},
    "svg": {"Creator": None, "Date": None},
}
"""What keeps the day and the program out of a file: the same picture is the same bytes."""

DESCRIPTION = """\
Compute and draw the paper's figures: 2, what neighbours near and far contribute; 3, the steady
states of equal birds; 4, the span ratios of one bird that keep the formation; 5, steady states with
one bird of another span. Each as PNG and SVG, and its data as CSV."""

EXAMPLES = """\
  ./flock figures                     writes docs/figures/figure_2.png and all the others
  ./flock figures --output figures"""


@dataclass(frozen=True)
class PaperFigure:
    """A figure of the paper and the data in it."""

    number: int
    picture: Figure
    tables: dict[str, Table]
    """Data by the panels that show them; `""` for all."""

    def files(self) -> Iterator[tuple[str, bytes]]:
        """Yield the name and the content of every file of the figure."""
        name = f"figure_{self.number}"
        _pin(self.picture)
        for kind, metadata in NAMELESS.items():
            content = BytesIO()
            with mpl.rc_context({"svg.hashsalt": name, "svg.fonttype": "path"}):
                self.picture.savefig(content, dpi=RESOLUTION, format=kind, metadata=metadata)
            yield f"{name}.{kind}", content.getvalue()
        for panels, table in self.tables.items():
            yield f"{name}{panels}.csv", table.csv()


def _pin(figure: Figure) -> None:
    """Lay `figure` out, and leave it at that.

    What the solver of layouts gives differs from run to run in the last bits, of which SVG makes
    names.
    """
    figure.draw_without_rendering()
    figure.set_layout_engine("none")
    for axes in figure.axes:
        bounds = (round(length, PLACES) for length in axes.get_position().bounds)
        axes.set_position(Bbox.from_bounds(*bounds))


def paper_figures() -> Iterator[PaperFigure]:
    """Compute and draw the figures, one after another."""
    contributed = contributions()
    yield PaperFigure(2, draw_contributions(contributed), {"": contributed.table()})

    equal = steady_flocks()
    tables = {"a": equal.configurations(), "bc": equal.means()}
    yield PaperFigure(3, draw_steady(equal), tables)

    flock = FlockConfiguration(birds=13)
    limits = exact_limits(flock, modified_birds(flock), LOW, HIGH)
    picture = draw_limits(limits, flock, LOW, HIGH)
    yield PaperFigure(4, picture, {"": limits_table(limits, flock)})

    modified = modified_flocks()
    yield PaperFigure(5, draw_modified(modified), {"": modified_table(modified)})


def tool(arguments: Sequence[str]) -> int:
    """Write the figures and say where they are."""
    parser = Parser("figures", DESCRIPTION, EXAMPLES)
    parser.add_argument(
        "--output", metavar="DIR", type=Path, default=OUTPUT, help=f"where to ({OUTPUT})"
    )
    output: Path = parser.parse_args(arguments).output
    try:
        output.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FlockError(f"--output {output}: can't be made: {error.strerror}") from error
    for figure in paper_figures():
        for name, content in figure.files():
            path = output / name
            try:
                path.write_bytes(content)
            except OSError as error:
                raise FlockError(f"--output {path}: can't be written: {error.strerror}") from error
            print(path)
    return 0


def main() -> int:
    """Run the `figures` executable."""
    return run_tool(tool)


if __name__ == "__main__":
    sys.exit(main())
