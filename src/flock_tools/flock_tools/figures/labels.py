# SPDX-License-Identifier: Apache-2.0
"""Labels that must not overlap."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.transforms import Bbox

APART = 1.0
"""Least distance between two labels, in pt."""


def keep_apart(figure: Figure, labels: Sequence[Text]) -> None:
    """Hide each of `labels` that overlaps one before it. The most important one is the first.

    A label that is cut off at the left or right edge of the figure is written beside its place.
    """
    figure.draw_without_rendering()  # lays the figure out
    room = 0.5 * APART * figure.dpi / 72.0
    taken: list[Bbox] = []
    for label in labels:
        box = Text.get_window_extent(label)  # the text alone, without an arrow
        if box.x0 < figure.bbox.x0 or box.x1 > figure.bbox.x1:
            label.set_horizontalalignment("left" if box.x0 < figure.bbox.x0 else "right")
            box = Text.get_window_extent(label)
        box = box.padded(room)
        if any(_overlap(box, other) for other in taken):
            label.set_visible(False)
        else:
            taken.append(box)


def _overlap(one: Bbox, other: Bbox) -> bool:
    return bool(one.x0 < other.x1 and other.x0 < one.x1 and one.y0 < other.y1 and other.y0 < one.y1)
