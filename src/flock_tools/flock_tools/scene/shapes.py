# SPDX-License-Identifier: Apache-2.0
"""A flock in space, as the coloured shapes in SI units that `view` shows.

The frame of the shapes moves with the flock. Its origin is that of the snapshot, usually the
leader's wing. In m, x is forward, y left and z up.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np
import numpy.typing as npt
from matplotlib.colors import Colormap, LinearSegmentedColormap, Normalize

from flock_sim.physics.arrays import FloatArray
from flock_tools.figures.style import DRAG_SAVED, saved_scale
from flock_tools.scene import wake
from flock_tools.scene.bird_mesh import BIRD, SHADE
from flock_tools.scene.snapshot import Snapshot

UPWASH = LinearSegmentedColormap.from_list(
    "upwash", ["#f1f2fb", "#d0d1d6", "#adadad", "#b9604f", "#6b0a18"]
)
"""Sinking air is pale. Rising air, which saves drag, is red. The faster it rises, the darker it is,
so the two differ in a grey print, too. No bird has these colours."""

INK = (0.55, 0.6, 0.65, 1.0)
"""Colour of text and trails, visible on black and on white."""

LEGEND = np.linspace(0.0, 1.0, 24)
"""Values of the cells of legends, from one end of the scale to the other."""


class Kind(IntEnum):
    """The kind of a shape, with the numbers of visualization_msgs/Marker."""

    LINE = 4
    CUBES = 6
    TEXT = 9
    TRIANGLES = 11


@dataclass(frozen=True)
class Shape:
    """One marker. `points` and `colours` have shape (points, 3) and (points, 4).

    A text has no points and one colour; triangles have three points each.
    """

    group: str
    number: int
    kind: Kind
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    scale: tuple[float, float, float] = (1.0, 1.0, 1.0)
    points: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))
    colours: FloatArray = field(default_factory=lambda: np.array([INK]))
    text: str = ""


@dataclass(frozen=True)
class Scene:
    """The shapes and the upwash of a snapshot."""

    snapshot: Snapshot
    shapes: list[Shape]
    upwash: npt.NDArray[np.float32]
    """Upward velocity on the plane behind the flock, in m/s, (rows, columns) from the top left."""
    most_upwash: float
    """End of the colour scale of upwash, in m/s: twice the downwash far behind one bird."""


def scene(
    snapshot: Snapshot, trail: Sequence[FloatArray] = (), rows: int = wake.PLANE_ROWS
) -> Scene:
    """Return the scene of `snapshot`. `trail` has earlier values of `along`, oldest first.

    `rows` is the number of rows of cells of the plane behind the flock.
    """
    metre, speed = snapshot.metre, snapshot.configuration.min_drag_speed
    known = snapshot.known
    shapes = list(_birds(snapshot))
    shapes += _trails(snapshot, trail)
    nothing = Scene(snapshot, shapes, np.zeros((1, 1), dtype=np.float32), 0.0)
    if not known.any():
        return nothing
    air = wake.Vortices(
        snapshot.along[known],
        snapshot.lateral[known],
        snapshot.span_ratio[known],
        snapshot.state.circulation[known],
    )
    most = 2.0 * abs(air.far_downwash)
    if not 0.0 < most < np.inf:  # impossible in a flight, but messages may have it
        return nothing
    scale = Normalize(-most, most, clip=True)
    plane = wake.plane(air, rows)
    shapes += _ribbons(snapshot, air, plane.position, scale)
    shapes.append(_plane(plane, metre, scale))
    shapes += _legends(snapshot, most * speed)
    with np.errstate(over="ignore"):  # a diverged flock: numbers beyond float32 become infinite
        upwash = (speed * plane.upwash).astype(np.float32)
    return Scene(snapshot, shapes, upwash, most * speed)


def in_metres(point: FloatArray, metre: float) -> FloatArray:
    """Return points given by position, lateral and height in b as x, y and z in m."""
    return np.asarray(metre * point * (1.0, -1.0, 1.0))


def _birds(snapshot: Snapshot) -> Iterator[Shape]:
    """Yield each bird and its label."""
    scale = saved_scale(snapshot.saved)
    face = DRAG_SAVED(np.repeat(scale(snapshot.saved)[:, np.newaxis], len(SHADE), axis=1))
    face[..., :3] *= SHADE[:, np.newaxis]
    face[~np.isfinite(snapshot.saved)] = 1.0
    for i in np.flatnonzero(snapshot.known):
        size = float(snapshot.span_ratio[i] * snapshot.metre)
        place = np.array([snapshot.along[i], snapshot.lateral[i], 0.0])
        x, y, _ = (float(value) for value in in_metres(place, snapshot.metre))
        yield Shape(
            "birds",
            int(i) + 1,
            Kind.TRIANGLES,
            origin=(x, y, 0.0),
            points=size * BIRD.reshape(-1, 3),
            colours=np.repeat(face[i], 3, axis=0),
        )
        yield Shape(
            "labels",
            int(i) + 1,
            Kind.TEXT,
            origin=(x, y, 0.5 * snapshot.metre),
            scale=(0.0, 0.0, 0.3 * snapshot.metre),
            text=f"{i + 1}\n{snapshot.saved[i]:.1f} %",
        )


def _trails(snapshot: Snapshot, trail: Sequence[FloatArray]) -> Iterator[Shape]:
    """Yield the path of each bird in the formation. It fades into the past."""
    path = np.array([*trail, snapshot.along])
    if len(path) < 2:
        return
    fading = np.tile(INK, (len(path), 1))
    fading[:, 3] = np.linspace(0.05, 0.9, len(path))
    for i in np.flatnonzero(snapshot.known):
        there = np.isfinite(path[:, i])
        if not there.any():
            continue
        point = np.zeros((int(there.sum()), 3))
        point[:, 0] = path[there, i]
        point[:, 1] = snapshot.lateral[i]
        yield Shape(
            "trails",
            int(i) + 1,
            Kind.LINE,
            scale=(0.04 * snapshot.metre, 0.0, 0.0),
            points=in_metres(point, snapshot.metre),
            colours=fading[there],
        )


def _ribbons(
    snapshot: Snapshot, air: wake.Vortices, end: float, scale: Normalize
) -> Iterator[Shape]:
    """Yield the wake of each bird, coloured by upwash. It fades away from the bird."""
    point, upwash = wake.ribbons(air, end)
    colour = UPWASH(scale(upwash))
    colour[..., 3] = (0.9 - 0.5 * wake.ALONG)[:, np.newaxis]
    for k, i in enumerate(np.flatnonzero(snapshot.known)):
        yield Shape(
            "wakes",
            int(i) + 1,
            Kind.TRIANGLES,
            points=in_metres(_triangles(point[k]), snapshot.metre),
            colours=_triangles(colour[k]),
        )


def _triangles(grid: FloatArray) -> FloatArray:
    """Return the corners of the triangles between the points of a grid, shape (points, ...)."""
    first, second, third, fourth = grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]
    corners = np.stack([first, second, third, first, third, fourth], axis=2)
    return np.asarray(corners.reshape(-1, grid.shape[-1]))


def _plane(plane: wake.Plane, metre: float, scale: Normalize) -> Shape:
    """Return the field behind the flock, one cube per cell. Cells without motion are clear."""
    colour = UPWASH(scale(plane.upwash))
    colour[..., 3] = 0.2 + 0.7 * np.abs(2.0 * scale(plane.upwash) - 1.0)
    return Shape(
        "upwash",
        0,
        Kind.CUBES,
        scale=(0.01 * metre, plane.width * metre, plane.height * metre),
        points=in_metres(plane.middle.reshape(-1, 3), metre),
        colours=colour.reshape(-1, 4),
    )


def _legends(snapshot: Snapshot, most: float) -> Iterator[Shape]:
    """Yield the title and the colour scales; `most` is the end of the scale of air, in m/s."""
    front = 2.0 + float(snapshot.along[snapshot.known].max())
    birds = len(snapshot.state.position)
    name = f"{birds} bird{'s' * (birds > 1)}, t = {snapshot.state.time:g} b/U_min"
    if snapshot.members > 1:
        name += f", member {snapshot.member + 1} of {snapshot.members}"
    saved = float(np.mean(snapshot.saved))
    yield _text(snapshot, 0, (front + 1.6, 0.0), f"{name}\nmean drag saved {saved:.1f} %", 0.5)
    scale = saved_scale(snapshot.saved)
    yield from _legend(
        snapshot, 1, front + 0.6, DRAG_SAVED, "drag saved", f"{scale.vmin:g} %", f"{scale.vmax:g} %"
    )
    yield from _legend(
        snapshot, 2, front, UPWASH, "air", f"down {most:.1f} m/s", f"up {most:.1f} m/s"
    )


def _legend(
    snapshot: Snapshot, number: int, along: float, colours: Colormap, name: str, low: str, high: str
) -> Iterator[Shape]:
    """Yield a colour scale of 4 b, across the flight in front of it."""
    across = 4.0 * LEGEND - 2.0
    point = np.column_stack([np.full_like(across, along), across, np.zeros_like(across)])
    yield Shape(
        "legend",
        number,
        Kind.CUBES,
        scale=(0.2 * snapshot.metre, 4.0 / len(LEGEND) * snapshot.metre, 0.01 * snapshot.metre),
        points=in_metres(point, snapshot.metre),
        colours=colours(LEGEND),
    )
    yield _text(snapshot, 10 * number, (along, -3.2), f"{name}: {low}", 0.3)
    yield _text(snapshot, 10 * number + 1, (along, 3.0), high, 0.3)


def _text(
    snapshot: Snapshot, number: int, place: tuple[float, float], text: str, size: float
) -> Shape:
    x, y, _ = (float(value) for value in in_metres(np.array([*place, 0.0]), snapshot.metre))
    return Shape(
        "legend",
        number,
        Kind.TEXT,
        origin=(x, y, 0.0),
        scale=(0.0, 0.0, size * snapshot.metre),
        text=text,
    )
