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
from flock_tools.scene.panel import Panel
from flock_tools.scene.shapes import UPWASH, Scene, scene
from flock_tools.scene.snapshot import Snapshot
from flock_tools.scene.wake import LONGEST

WIDTH = 10.0
"""Width of the picture, in inches."""

BARS = 0.75
"""Height of the room for colour bars, in inches."""

LINE, ROOM = 0.21, 0.15
"""Height of a line of the title, and room beside all lines, in inches."""

CAPTION = 0.35
"""Height of the room for the captions of insets, in inches."""

HIGHEST = 0.5
"""Largest height of the row of insets, over the width of the picture."""

NARROWEST = 0.24
"""Smallest width of an inset, over that of the picture: its caption needs room."""

MOST_INSETS = 4
"""Largest number of insets. They show the largest parts."""

MOST_LISTED = 4
"""Largest number of birds that a caption lists."""

MOST_DIGITS = 1e6
"""Distance in b from which on it is written with an exponent."""

MOST_TRAIL = 300
"""Largest number of points of a trail, approximately."""

ROWS = 48
"""Number of rows of cells of the plane behind the flock."""

APART = 0.25
"""Largest gap along the flight within a part, over the extent of the flock across it."""


def scene_of(run: Run, time: float | None, m: int) -> Scene:
    """Return the scene of the member with index `m` at `time` in b / U_min; None: the last time.

    Raises FlockError if nothing was recorded at that time.
    """
    configuration, state = run.configuration, run.at(time)
    stamp = divmod(configuration.stamp(state.step), BILLION)
    snapshot = Snapshot.of(configuration, state, configuration.span_ratio, m, stamp)
    rows = state.step // configuration.record_every + 1
    history = read(run, end=state.time, stride=-(-rows // MOST_TRAIL)).position[..., m]
    leader = history.sel(bird=formation.leader(configuration.birds))
    return scene(snapshot, list((history - leader).transpose("time", "bird").to_numpy()), ROWS)


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
    row = max((w * inset.camera.height for w, inset in zip(widths, insets)), default=0.0)
    row = WIDTH * row + CAPTION if insets else 0.0
    title = _title(snapshot, others[MOST_INSETS:])
    head = LINE * (title.count("\n") + 1) + ROOM
    tall = WIDTH * panel.camera.height
    height = BARS + row + tall + head
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, height))
        figure.text(0.02, 1.0 - 0.5 * ROOM / height, title, va="top", fontsize=10)
        bottom = BARS + row
        labels = panel.draw(figure.add_axes((0.0, bottom / height, 1.0, tall / height)))
        captions: list[Text] = []
        left = 0.0
        for inset, width in zip(insets, widths):
            inset_height = WIDTH * width * inset.camera.height
            top = bottom - CAPTION
            box = (left, (top - inset_height) / height, width, inset_height / height)
            labels += inset.draw(figure.add_axes(box))
            place = (left + 0.02, (bottom - 0.5 * CAPTION) / height)
            captions.append(figure.text(*place, _caption(inset), va="center", fontsize=8.5))
            left += width
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
    """Return the widths of insets over that of the picture, on the scale of `panel` if they fit.

    They are side by side.
    """
    widths = np.array([max(NARROWEST, one.camera.scope / panel.camera.scope) for one in insets])
    if not insets:
        return widths
    heights = widths * [one.camera.height for one in insets]
    return widths * min(1.0, 1.0 / float(widths.sum()), HIGHEST / float(heights.max()))


def _empty(shown: Scene) -> Figure:
    """Return the picture of a flock of which no bird can be drawn."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, 2.0))
        figure.text(0.02, 0.92, _title(shown.snapshot, []), va="top", fontsize=10)
        figure.text(0.5, 0.4, "no bird has a finite position and circulation", ha="center")
    return figure


def _title(snapshot: Snapshot, left_out: Sequence[IntArray]) -> str:
    name = flock_name(snapshot.configuration, snapshot.member)
    saved = np.mean(snapshot.saved)
    title = f"{name}\nt = {snapshot.state.time:g}:  mean drag reduction {saved:.1f} %"
    if count := sum(len(part) for part in left_out):
        title += f";  {count} bird{'s' * (count > 1)} far from all others not drawn"
    return title


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
    return f"{name}: {far} b {'ahead of' if along > 0.0 else 'behind'} the leader"


def _bar(figure: Figure, left: float, colours: ScalarMappable, name: str) -> None:
    """Draw a colour bar along the bottom."""
    height = figure.get_figheight()
    axes = figure.add_axes((left, 0.42 / height, 0.36, 0.12 / height))
    bar = figure.colorbar(colours, cax=axes, orientation="horizontal")
    bar.set_label(name)
    bar.outline.set_visible(False)
