# SPDX-License-Identifier: Apache-2.0
"""The file that a tool writes its result or picture to, named by --output.

Matplotlib takes half a second to import, so it is imported only to draw.
"""

from __future__ import annotations

import os
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

from flock_sim.errors import FlockError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

RESOLUTION = 200
"""Resolution of a raster picture, in dots per inch."""


def check_output(output: Path, option: str = "--output") -> None:
    """Raise FlockError if the file can't be written. Called before computing.

    `option` is the option that named the file.
    """
    try:
        exists = output.exists()
        if output.is_dir():
            raise FlockError(f"{option} {output}: is a directory; name a file in it")
        if exists and not output.is_file():
            raise FlockError(f"{option} {output}: is a device or a pipe; name a regular file")
        if not output.parent.is_dir():
            raise FlockError(
                f"{option} {output}: can't be written: {output.parent} is no directory"
            )
    except OSError as error:  # the name is too long, or a directory can't be searched
        raise _refused(output, option, error) from error
    if not os.access(output if exists else output.parent, os.W_OK):
        raise FlockError(f"{option} {output}: can't be written: Permission denied")


def write_output(output: Path, content: bytes | memoryview, option: str = "--output") -> None:
    """Write `content`. Raises FlockError if that fails, or if there is a device or a pipe."""
    check_output(output, option)
    try:
        output.write_bytes(content)
    except OSError as error:
        raise _refused(output, option, error) from error


def _refused(output: Path, option: str, error: OSError) -> FlockError:
    return FlockError(f"{option} {output}: can't be written: {error.strerror}")


def check_picture(output: Path | None, option: str = "--output") -> None:
    """Raise FlockError if no picture can be written to the file. Called before computing.

    None means no picture, and passes. `option` is the option that named the file.
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
