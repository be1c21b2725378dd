# SPDX-License-Identifier: Apache-2.0
"""The texts of a scene: labels of birds, a title, and the legends of both colour scales.

Texts face the viewer, so their extent does not depend on the direction of view. They are arranged
so that none is on top of another one, seen from behind, from in front or from above.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from matplotlib.colors import Colormap

from flock_sim.physics import formation
from flock_tools.figures.style import DRAG_SAVED, saved_scale
from flock_tools.scene.marker import UPWASH, Kind, Shape, in_metres
from flock_tools.scene.snapshot import Snapshot

LARGE, SMALL = 0.5, 0.3
"""Height of a line of the title and of other texts in a flock of usual width, in b."""

USUAL = 30.0
"""Largest usual width, in b. In a wider flock, texts grow with the width, to be read from afar."""

CHARACTER = 0.65
"""Width of a character over the height of its line, in the widest usual font."""

ABOVE = 0.5
"""Height of a label above its bird, in b."""

FRONT, NEXT, TITLE = 2.6, 0.9, 2.0
"""Distances along the flight, in b: from the first bird to the first legend, from there to the
second legend, and from there to the title. Seen from 25 degrees above the horizon, they are still
more than the height of the texts."""

CELLS = np.linspace(0.0, 1.0, 24)
"""Values of the cells of legends, from one end of the scale to the other."""

HALF = 2.0
"""Half of the length of a legend's scale, in b."""

GAP = 0.2
"""Gap between a scale and its texts, and smallest gap between two labels, in b."""


MOST_PLAIN = 1e4
"""Number from which on one is written in short."""


def label_text(snapshot: Snapshot, bird: int) -> str:
    """Return the label of `bird`, from 1: its number, and the drag that it saves."""
    return f"{bird}\n{rounded(snapshot.saved[bird - 1])} %"


def label_rank(snapshot: Snapshot, bird: int) -> int:
    """Return how dispensable a label is: 0 for the leader and both ends, 3 for most birds."""
    birds = len(snapshot.span_ratio)
    outer = bird in (1, formation.leader(birds), birds)
    return (outer, snapshot.span_ratio[bird - 1] != 1.0, bird % 10 == 0, True).index(True)


def labels(snapshot: Snapshot) -> Iterator[Shape]:
    """Yield the labels of birds. A label that would overlap a more important one is left out."""
    grown = _enlargement(snapshot)
    birds = [int(i) + 1 for i in np.flatnonzero(snapshot.known)]
    leader = formation.leader(len(snapshot.span_ratio))
    birds.sort(key=lambda bird: (label_rank(snapshot, bird), abs(bird - leader)))
    taken: list[tuple[float, float]] = []
    for bird in birds:
        text, lateral = label_text(snapshot, bird), float(snapshot.lateral[bird - 1])
        half = grown * (0.5 * _width(text, SMALL) + 0.5 * GAP)
        if any(abs(lateral - other) < half + beside for other, beside in taken):
            continue
        taken.append((lateral, half))
        place = (float(snapshot.along[bird - 1]), lateral, ABOVE * grown)
        yield _text(snapshot, "labels", bird, place, text, SMALL * grown)


def rounded(value: float) -> str:
    """Return a number with one decimal, or that of a diverged flock in short."""
    return f"{value:.1f}" if abs(value) < MOST_PLAIN else f"{value:.3g}"


def legends(snapshot: Snapshot, most: float) -> Iterator[Shape]:
    """Yield the title and the colour scales; `most` is the end of the scale of air, in m/s."""
    grown = _enlargement(snapshot)
    front = float(snapshot.along[snapshot.known].max()) + FRONT * grown
    title_at = (front + (NEXT + TITLE) * grown, 0.0, 0.0)
    yield _text(snapshot, "legend", 0, title_at, _title(snapshot), LARGE * grown)
    saved = saved_scale(snapshot.saved)
    ends = f"{saved.vmin:g} %", f"{saved.vmax:g} %"
    yield from _legend(snapshot, 1, front + NEXT * grown, DRAG_SAVED, "drag saved", ends)
    ends = f"down {rounded(most)} m/s", f"up {rounded(most)} m/s"
    yield from _legend(snapshot, 2, front, UPWASH, "air", ends)


def _title(snapshot: Snapshot) -> str:
    birds = len(snapshot.state.position)
    name = f"{birds} bird{'s' * (birds > 1)}, t = {snapshot.state.time:g} b/U_min"
    if snapshot.members > 1:
        name += f", member {snapshot.member + 1} of {snapshot.members}"
    return f"{name}\nmean drag saved {rounded(float(np.mean(snapshot.saved)))} %"


def _legend(
    snapshot: Snapshot,
    number: int,
    along: float,
    colours: Colormap,
    name: str,
    ends: tuple[str, str],
) -> Iterator[Shape]:
    """Yield a colour scale across the flight, and the values at its `ends` beside it."""
    size = _enlargement(snapshot) * snapshot.metre
    across = _enlargement(snapshot) * HALF * (2.0 * CELLS - 1.0)
    point = np.column_stack([np.full_like(across, along), across, np.zeros_like(across)])
    yield Shape(
        "legend",
        number,
        Kind.CUBES,
        scale=(0.2 * size, 2.0 * HALF / len(CELLS) * size, 0.01 * size),
        points=in_metres(point, snapshot.metre),
        colours=colours(CELLS),
    )
    for k, (text, side) in enumerate(((f"{name}: {ends[0]}", -1.0), (ends[1], 1.0))):
        beside = side * (HALF + GAP + 0.5 * _width(text, SMALL)) * _enlargement(snapshot)
        height = SMALL * _enlargement(snapshot)
        yield _text(snapshot, "legend", 10 * number + k, (along, beside, 0.0), text, height)


def _enlargement(snapshot: Snapshot) -> float:
    """Return the factor by which the texts of this flock are larger than those of a usual one."""
    return max(1.0, (float(np.ptp(snapshot.lateral)) + 2.0) / USUAL)


def _width(text: str, height: float) -> float:
    """Return the width of a text whose lines have this height."""
    return CHARACTER * height * max(len(line) for line in text.split("\n"))


def _text(
    snapshot: Snapshot,
    group: str,
    number: int,
    place: tuple[float, float, float],
    text: str,
    height: float,
) -> Shape:
    """Return a text at `place` (position, lateral, height), in b, whose lines have this height."""
    x, y, z = (float(value) for value in in_metres(np.array(place), snapshot.metre))
    scale = (0.0, 0.0, height * snapshot.metre)
    return Shape(group, number, Kind.TEXT, origin=(x, y, z), scale=scale, text=text)
