# SPDX-License-Identifier: Apache-2.0
"""The air behind a flock as a picture with a legend, for viewers without a colour scale."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np
import numpy.typing as npt
from matplotlib import get_data_path
from matplotlib.colors import Normalize
from matplotlib.ft2font import FT2Font

from flock_tools.scene.lettering import rounded
from flock_tools.scene.marker import UPWASH
from flock_tools.scene.shapes import Scene

Pixels = npt.NDArray[np.uint8]

LEAST_PIXELS, LEAST_WIDTH = 4, 480
"""Smallest side of a cell, and smallest width of the picture, in pixels."""

LEGEND, MARGIN = 30, 8
"""Height of the legend below the air, and margins within it, in pixels."""

LETTERS = 13
"""Size of the letters, in pixels."""

PAPER, INK = 255, 34
"""Grey of the legend's background and of its letters."""


def upwash_image(shown: Scene) -> Pixels:
    """Return the upwash of a scene in the colours of its plane, with a legend below.

    Shape (rows, columns, 3), from the top left, seen from behind. The plane is enlarged.
    """
    side = max(LEAST_PIXELS, -(-LEAST_WIDTH // shown.upwash.shape[1]))
    most = shown.most_upwash or 1.0
    with np.errstate(invalid="ignore"):
        colours = UPWASH(Normalize(-most, most, clip=True)(shown.upwash), bytes=True)[..., :3]
    air = colours.repeat(side, axis=0).repeat(side, axis=1)
    return np.concatenate([air, _legend(rounded(shown.most_upwash), air.shape[1])])


@lru_cache(maxsize=64)
def _legend(most: str, width: int) -> Pixels:
    """Return the colour scale of the air between the texts of its ends."""
    strip = np.full((LEGEND, width, 3), PAPER, dtype=np.uint8)
    down, up = _letters(f"air: down {most} m/s"), _letters(f"up {most} m/s")
    first, last = 2 * MARGIN + down.shape[1], width - 2 * MARGIN - up.shape[1]
    for letters, left in ((down, MARGIN), (up, last + MARGIN)):
        top = (LEGEND - letters.shape[0]) // 2
        place = strip[top : top + letters.shape[0], left : left + letters.shape[1]]
        place[:] = letters[..., np.newaxis]
    scale = UPWASH(np.linspace(0.0, 1.0, last - first), bytes=True)[:, :3]
    strip[MARGIN:-MARGIN, first:last] = scale
    return strip


def _letters(text: str) -> Pixels:
    """Return a text in grey, shape (rows, columns)."""
    font = FT2Font(Path(get_data_path()) / "fonts/ttf/DejaVuSans.ttf")
    font.set_size(LETTERS, 72.0)
    font.set_text(text, 0.0)
    font.draw_glyphs_to_bitmap(antialiased=True)
    darkness = np.array(font.get_image(), dtype=float) / 255.0
    return np.asarray(PAPER + (INK - PAPER) * darkness, dtype=np.uint8)
