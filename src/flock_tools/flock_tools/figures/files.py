# SPDX-License-Identifier: Apache-2.0
"""The files of the figures in the documents: PNG and SVG, and their data as CSV."""

from __future__ import annotations

from argparse import ArgumentParser
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

from flock_sim.console.arguments import print_text
from flock_sim.errors import FlockError
from flock_tools.figures.output import write_output

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from flock_tools.figures.table import Table

OUTPUT = Path("docs/figures")

RESOLUTION = 300
"""Resolution of PNG files, in dots per inch."""

PLACES = 5
"""Decimal places of positions, relative to the figure."""

NAMELESS: dict[str, dict[str, Any]] = {
    "png": {"Software": None},
    "svg": {"Creator": None, "Date": None},
}
"""Metadata that remove date and program, so that equal pictures are equal bytes."""


@dataclass(frozen=True)
class FigureFiles:
    """A figure, the first part of its file names, and its data."""

    name: str
    picture: Figure
    tables: dict[str, Table]
    """Data by panel; `""` for all panels."""

    def files(self) -> Iterator[tuple[str, bytes]]:
        """Yield the name and the content of every file of the figure."""
        import matplotlib as mpl

        _pin(self.picture)
        for kind, metadata in NAMELESS.items():
            content = BytesIO()
            with mpl.rc_context({"svg.hashsalt": self.name, "svg.fonttype": "path"}):
                self.picture.savefig(content, dpi=RESOLUTION, format=kind, metadata=metadata)
            yield f"{self.name}.{kind}", content.getvalue()
        for panels, table in self.tables.items():
            yield f"{self.name}{panels}.csv", table.csv()


def _pin(figure: Figure) -> None:
    """Compute the layout of `figure` once and round it.

    The results of the layout solver differ from run to run in their last bits, and SVG derives
    names from these bits.
    """
    from matplotlib.transforms import Bbox

    figure.draw_without_rendering()
    figure.set_layout_engine("none")
    for axes in figure.axes:
        bounds = (round(length, PLACES) for length in axes.get_position().bounds)
        axes.set_position(Bbox.from_bounds(*bounds))


def add_output_option(parser: ArgumentParser) -> None:
    """Add the option for the directory of the figures."""
    parser.add_argument(
        "--output", metavar="DIR", type=Path, default=OUTPUT, help=f"directory for them ({OUTPUT})"
    )


def write_figures(figures: Iterable[FigureFiles], output: Path) -> None:
    """Write all files of `figures`, one figure after the other, and print their paths.

    Raises FlockError if they can't be written.
    """
    try:
        output.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FlockError(f"--output {output}: can't be created: {error.strerror}") from error
    for figure in figures:
        for name, content in figure.files():
            path = output / name
            write_output(path, content)
            print_text(str(path))
