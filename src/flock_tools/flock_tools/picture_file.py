# SPDX-License-Identifier: Apache-2.0
"""The file that a picture is written to.

Matplotlib takes half a second to import: only what draws waits for it.
"""

from __future__ import annotations

from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

from flock_sim.errors import FlockError
from flock_tools.output_file import check_output, write_output

if TYPE_CHECKING:
    from matplotlib.figure import Figure

RESOLUTION = 200
"""Of a picture made of dots, in dots per inch."""


def check_picture(output: Path | None, option: str = "--output") -> None:
    """Refuse a file that no picture can be written to, before anything is computed.

    Raises FlockError; None is no picture, and fine. `option` is what the file was named by.
    """
    if output is None:
        return
    _format(output, option)
    check_output(output, option)


def write_picture(figure: Figure, output: Path, option: str = "--output") -> None:
    """Write `figure` in the format that the name ends in. Raises FlockError where it can't be."""
    picture = BytesIO()
    figure.savefig(picture, dpi=RESOLUTION, format=_format(output, option))
    write_output(output, picture.getbuffer(), option)


def _format(output: Path, option: str) -> str:
    """Return the format that a name ends in, png where it has no ending."""
    from matplotlib.backend_bases import FigureCanvasBase

    kind = output.suffix.lstrip(".").lower() or "png"
    kinds = FigureCanvasBase.get_supported_filetypes()
    if kind not in kinds:
        raise FlockError(f"{option} {output}: must end in one of {', '.join(sorted(kinds))}")
    return kind
