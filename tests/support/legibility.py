# SPDX-License-Identifier: Apache-2.0
"""What is written in a figure, and whether it can be read."""

from __future__ import annotations

from unittest import mock
from weakref import WeakKeyDictionary

import numpy as np
from matplotlib.figure import Figure
from matplotlib.text import Text

_known: WeakKeyDictionary[Figure, list[Text]] = WeakKeyDictionary()


def texts(figure: Figure) -> list[Text]:
    """What is written in a figure: of ticks, only those that are shown.

    To draw a figure takes half a second, so it is drawn again only if it has changed.
    """
    if figure.stale or figure not in _known:
        _known[figure] = _texts_drawn(figure)
    return _known[figure]


def _texts_drawn(figure: Figure) -> list[Text]:
    drawn: list[Text] = []
    draw = Text.draw

    def record(self: Text, renderer: object) -> None:
        if self.get_visible() and self.get_text():
            drawn.append(self)
        draw(self, renderer)

    figure.draw_without_rendering()  # lays it out
    with mock.patch.object(Text, "draw", record):
        figure.draw_without_rendering()
    return list({id(text): text for text in drawn}.values())


def cut_off(figure: Figure) -> list[str]:
    """What is written beyond the edge of a figure."""
    found = texts(figure)
    first, last = _corners(found)
    beyond = (first < figure.bbox.min) | (last > figure.bbox.max)
    return [text.get_text() for text, cut in zip(found, beyond.any(axis=1), strict=True) if cut]


def overlaps(figure: Figure, tolerance: float = 0.5) -> list[tuple[str, str]]:
    """Pairs of texts of which one is on top of the other, by more than `tolerance` in pt."""
    found = texts(figure)
    first, last = _corners(found)
    common = np.minimum(last[:, None], last) - np.maximum(first[:, None], first)  # (text, text, 2)
    on_top = np.triu(common.min(axis=2) > tolerance * figure.dpi / 72.0, 1)
    return [(found[i].get_text(), found[j].get_text()) for i, j in np.argwhere(on_top)]


def _corners(found: list[Text]) -> tuple[np.ndarray, np.ndarray]:
    """The lower left and the upper right corner of each text, without arrows."""
    boxes = [Text.get_window_extent(text).get_points() for text in found]
    first, last = np.moveaxis(boxes, 1, 0)
    return first, last
