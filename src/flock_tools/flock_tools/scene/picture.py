# SPDX-License-Identifier: Apache-2.0
"""The scene that `view` publishes, as a picture file."""

from __future__ import annotations

from collections.abc import Sequence

import matplotlib as mpl
import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.text import Text

from flock_sim.messages.types import BILLION
from flock_sim.physics import formation
from flock_sim.physics.arrays import FloatArray, IntArray
from flock_sim.recording.run import Run
from flock_tools.figures.labels import keep_apart
from flock_tools.figures.parts import parts
from flock_tools.figures.style import DRAG_SAVED, STYLE, flock_name, saved_scale
from flock_tools.runs.dataset import read
from flock_tools.scene.lettering import rounded
from flock_tools.scene.marker import UPWASH
from flock_tools.scene.panel import SMALL, Panel
from flock_tools.scene.shapes import Scene, scene
from flock_tools.scene.snapshot import Snapshot
from flock_tools.scene.wake import LONGEST, PLANE_ROWS

WIDTH = 10.0
"""Width of the picture, in inches."""

BARS = 0.75
"""Height of the room for colour bars, in inches."""

LINE, ROOM = 0.21, 0.15
"""Height of a line of the title, and room beside all lines, in inches."""

CAPTION = 0.45
"""Height of the room for the captions of insets, in inches."""

HIGHEST = 0.5
"""Largest height of the row of insets, over the width of the picture."""

NARROWEST = 0.24
"""Smallest width of an inset, over that of the picture: its caption needs room."""

MOST_INSETS = 4
"""Largest number of insets. They show the largest parts."""

COLUMNS, ROW = 16, 0.36
"""Number of columns of the list of birds that are not drawn, and height of a row, in inches."""

MOST_LISTED = 4
"""Largest number of birds that a caption lists."""

MOST_DIGITS = 1e6
"""Distance in b from which on it is written with an exponent."""

MOST_TRAIL = 300
"""Largest number of points of a trail, approximately."""

FINE_ROWS = 48
"""Number of rows of cells of the plane behind the flock in a smooth picture."""

APART = 0.25
"""Largest gap along the flight within a part, over the extent of the flock across it."""


def scene_of(run: Run, time: float | None, m: int, rows: int = PLANE_ROWS) -> Scene:
    """Return the scene of the member with index `m` at `time` in b / U_min; None: the last time.

    `rows` is the number of rows of cells of the plane behind the flock. Raises FlockError if
    nothing was recorded at that time.
    """
    configuration, state = run.configuration, run.at(time)
    stamp = divmod(configuration.stamp(state.step), BILLION)
    snapshot = Snapshot.of(configuration, state, configuration.span_ratio, m, stamp)
    recorded = state.step // configuration.record_every + 1
    history = read(run, end=state.time, stride=-(-recorded // MOST_TRAIL)).position[..., m]
    leader = history.sel(bird=formation.leader(configuration.birds))
    return scene(snapshot, list((history - leader).transpose("time", "bird").to_numpy()), rows)


def draw_scene(shown: Scene) -> Figure:
    """Return the picture of a scene. Without a bird, it says so.

    The part of the flock with the bird in the middle is drawn largest, other parts below it.
    """
    snapshot = shown.snapshot
    if not snapshot.known.any():
        return _empty(shown)
    main, *others = scene_parts(snapshot)
    panel = Panel.of(shown, main, with_plane=True)
    insets = [Panel.of(shown, part, with_plane=False) for part in others[:MOST_INSETS]]
    widths = _widths(panel, insets)
    heights = [min(HIGHEST, w * one.camera.height) for w, one in zip(widths, insets)]
    row = WIDTH * max(heights) + CAPTION if insets else 0.0
    left_out = np.sort(np.concatenate([[], *others[MOST_INSETS:]])).astype(int)
    table = -(-len(left_out) // COLUMNS) * ROW
    title = _title(snapshot)
    head = LINE * (title.count("\n") + 1) + ROOM
    tall = WIDTH * panel.camera.height
    height = BARS + table + row + tall + head
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, height))
        figure.text(0.02, 1.0 - 0.5 * ROOM / height, title, va="top", fontsize=10)
        bottom = BARS + table + row
        labels = panel.draw(figure.add_axes((0.0, bottom / height, 1.0, tall / height)))
        captions: list[Text] = []
        left = 0.0
        for inset, width, share in zip(insets, widths, heights):
            tall, top = WIDTH * share, bottom - CAPTION
            box = (left, (top - tall) / height, share / inset.camera.height, tall / height)
            labels += inset.draw(figure.add_axes(box))
            place = (left + 0.02, (bottom - 0.5 * CAPTION) / height)
            captions.append(figure.text(*place, _caption(inset), va="center", fontsize=8.5))
            left += width
        _list_left_out(figure, snapshot, left_out, BARS + table)
        saved = ScalarMappable(saved_scale(snapshot.saved), DRAG_SAVED)
        _bar(figure, 0.07, saved, "drag reduction $\\eta_i$ (%)")
        air = ScalarMappable(Normalize(-shown.most_upwash, shown.most_upwash), UPWASH)
        _bar(figure, 0.57, air, "upward air speed (m/s): pale air sinks, dark air rises")
        keep_apart(figure, [*captions, *labels])
    return figure


def scene_parts(snapshot: Snapshot) -> list[IntArray]:
    """Return the indices of the birds of each part: that in the middle, then the largest ones."""
    along = np.where(snapshot.known, snapshot.along, np.nan)
    extent = float(np.ptp(snapshot.lateral))
    found = parts(along, max(LONGEST, APART * extent), np.inf)
    middle = formation.middle_position(along[snapshot.known])
    return sorted(found, key=lambda part: (middle not in along[part], -len(part)))


def _widths(panel: Panel, insets: Sequence[Panel]) -> FloatArray:
    """Return the widths of insets side by side, over that of the picture.

    They have the scale of `panel`, unless that is too wide, or too narrow for a caption.
    """
    widths = np.array([max(NARROWEST, one.camera.scope / panel.camera.scope) for one in insets])
    least = NARROWEST * len(insets)
    if widths.sum() <= 1.0:
        return widths
    return np.asarray(NARROWEST + (widths - NARROWEST) * (1.0 - least) / (widths.sum() - least))


def _empty(shown: Scene) -> Figure:
    """Return the picture of a flock of which no bird can be drawn."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, 2.0))
        figure.text(0.02, 0.92, _title(shown.snapshot), va="top", fontsize=10)
        figure.text(0.5, 0.4, "no bird has a finite position and circulation", ha="center")
    return figure


def _title(snapshot: Snapshot) -> str:
    name = flock_name(snapshot.configuration, snapshot.member)
    saved = np.mean(snapshot.saved)
    return f"{name}\nt = {snapshot.state.time:g}:  mean drag reduction {rounded(float(saved))} %"


def _list_left_out(figure: Figure, snapshot: Snapshot, birds: IntArray, top: float) -> None:
    """Write number and drag saved of birds that are not drawn, below `top` in inches."""
    if not len(birds):
        return
    height = figure.get_figheight()
    figure.text(0.02, top / height, "far from all others,\nnot drawn:", va="top", fontsize=SMALL)
    for k, i in enumerate(birds):
        row, column = divmod(k, COLUMNS)
        figure.text(
            0.19 + 0.05 * column,
            (top - ROW * row) / height,
            f"{i + 1}\n{rounded(snapshot.saved[i])} %",
            ha="center",
            va="top",
            fontsize=SMALL,
        )


def _caption(inset: Panel) -> str:
    """Return which birds an inset shows, and where they are."""
    birds, snapshot = inset.birds, inset.snapshot
    numbers = sorted(int(i) + 1 for i in birds)
    if len(numbers) == 1:
        name = f"bird {numbers[0]}"
    elif numbers == list(range(numbers[0], numbers[-1] + 1)):
        name = f"birds {numbers[0]} to {numbers[-1]}"
    else:
        listed = ", ".join(str(number) for number in numbers)
        name = f"{len(numbers)} birds" if len(numbers) > MOST_LISTED else f"birds {listed}"
    along = float(np.mean(snapshot.along[birds]))
    far = f"{abs(along):.0f}" if abs(along) < MOST_DIGITS else f"{abs(along):.3g}"
    return f"{name}\n{far} b {'ahead of' if along > 0.0 else 'behind'} the leader"


def _bar(figure: Figure, left: float, colours: ScalarMappable, name: str) -> None:
    """Draw a colour bar along the bottom."""
    height = figure.get_figheight()
    axes = figure.add_axes((left, 0.42 / height, 0.36, 0.12 / height))
    bar = figure.colorbar(colours, cax=axes, orientation="horizontal")
    bar.set_label(name)
    bar.outline.set_visible(False)
