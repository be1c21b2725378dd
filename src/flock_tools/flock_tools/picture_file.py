# SPDX-License-Identifier: Apache-2.0
"""The file that a picture is written to."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path

from matplotlib.backend_bases import FigureCanvasBase
from matplotlib.figure import Figure

from flock_sim.errors import FlockError

RESOLUTION = 200
"""Of a picture made of dots, in dots per inch."""


def picture_format(output: Path) -> str:
    """Return the format that a name ends in, png where it has no ending.

    Raises FlockError on one that can't be written: tools ask before they compute.
    """
    kind = output.suffix.lstrip(".").lower() or "png"
    kinds = FigureCanvasBase.get_supported_filetypes()
    if kind not in kinds:
        raise FlockError(f"--output {output}: must end in one of {', '.join(sorted(kinds))}")
    return kind


def write_picture(figure: Figure, output: Path) -> None:
    """Write `figure` in the format that the name ends in. Raises FlockError where it can't be."""
    picture = BytesIO()
    figure.savefig(picture, dpi=RESOLUTION, format=picture_format(output))
    try:
        output.write_bytes(picture.getbuffer())
    except OSError as error:
        raise FlockError(f"--output {output}: can't be written: {error.strerror}") from error
