# SPDX-License-Identifier: Apache-2.0
"""A flock in space, as the coloured shapes in SI units that `view` shows.

The frame of the shapes moves with the flock. Its origin is that of the snapshot, usually the
leader's wing. In m, x is forward, y left and z up.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from matplotlib.colors import Normalize

from flock_sim.physics.arrays import FloatArray
from flock_tools.figures.style import DRAG_SAVED, saved_scale
from flock_tools.scene import wake
from flock_tools.scene.bird_mesh import BIRD, SHADE
from flock_tools.scene.lettering import labels, legends
from flock_tools.scene.marker import INK, UPWASH, Kind, Shape, in_metres
from flock_tools.scene.snapshot import Snapshot


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
    shapes += labels(snapshot)
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
    shapes += legends(snapshot, most * speed)
    with np.errstate(over="ignore"):  # a diverged flock: numbers beyond float32 become infinite
        upwash = (speed * plane.upwash).astype(np.float32)
    return Scene(snapshot, shapes, upwash, most * speed)


def _birds(snapshot: Snapshot) -> Iterator[Shape]:
    """Yield each bird."""
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
